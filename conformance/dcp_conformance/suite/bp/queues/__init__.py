"""Test cases of BP: queues and buffers for payloads of client protocols."""
