// libFuzzer: as fuzz_session, with streams of small frames of other sensors than the HDL-64E, and of point clouds.
#include "fuzz_session.cpp"
