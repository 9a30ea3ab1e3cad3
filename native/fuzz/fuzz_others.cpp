// libFuzzer: as fuzz_session, with streams of small frames of other sensors than the HDL-64E.
#include "fuzz_session.cpp"
