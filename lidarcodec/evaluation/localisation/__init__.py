"""Finding the way by what was sent: the protocol of the PocoNet paper and the second measure of Tu 2016."""
