#include "bindings.hpp"

void bind_simulator(nb::module_&) {}
