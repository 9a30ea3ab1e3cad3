"""Other people's coders, measured beside ours on the same frames and with the same count of bits. No codecs of ours:
nothing of them goes over the wire."""
