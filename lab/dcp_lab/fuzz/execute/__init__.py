"""Execute fuzz tests: targets in process and over a link, and the comparison of a target with the model."""
