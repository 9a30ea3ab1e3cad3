"""Training of the networks of codec `riddle`: from any source to a weight file.

`drives` makes names of simulated drives and divides sources into clips. `variations` changes clips to other units of
the sensor and mirrors them. `samples` runs clips through the codec's quantisation, motion and warp, and stores the
networks' inputs for some returns on disk. `nets` has the network and its loss, `fitting` trains one network, and `run`
does everything and writes the file. A stopped run can be continued and gives exactly the same networks.
"""
