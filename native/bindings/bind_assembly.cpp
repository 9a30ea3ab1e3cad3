#include "bindings.hpp"

void bind_assembly(nb::module_&) {}
