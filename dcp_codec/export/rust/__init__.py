"""Export of the codec of a profile as a module in Rust: no allocation, no unsafe code, only the crate ``core``."""
