"""What commands and writers share: command lines, atomic writing of files, and text from untrusted sources."""
