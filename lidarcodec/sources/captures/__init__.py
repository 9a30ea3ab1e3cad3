"""Captures: pcap and pcapng, and datagrams out of their frames."""
