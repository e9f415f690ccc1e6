"""Network interfaces and sockets of Linux, for live capture, links and testers."""
