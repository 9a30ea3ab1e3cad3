"""A gate in front of a TLS port: what strangers can use up is bounded here, in a process of its own.

Zenoh's TLS listener pauses for 100 ms after each handshake that fails, and keeps a connection that sends nothing for
10 s (Zenoh issue 2685). So the gate takes the connections. It passes on those that begin with a TLS 1.3 ClientHello, a
few at a time, and bars an address whose handshakes fail. The gate has no key: TLS goes from the client to Zenoh.
"""
