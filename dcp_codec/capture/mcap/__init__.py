"""MCAP files: reader, writer, attachments and the messages that hold raw frames."""
