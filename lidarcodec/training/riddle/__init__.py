"""Training of the networks of codec `riddle`, from any source, to a weight file.

`drives` names simulated drives and cuts sources into clips; `variations` makes other units of the sensor of them, and
mirror images; `samples` runs clips through the codec's own quantisation, motion and warp and keeps what the networks
would see of some returns, on disk; `nets` is the network and its loss, `fitting` trains one, `run` does all of it and
writes the file. A run that is stopped goes on where it was, to the very same networks.
"""
