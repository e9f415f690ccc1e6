"""Network interfaces and sockets of Linux: live capture, and what links and testers share."""
