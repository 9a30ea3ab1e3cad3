#include "bindings.hpp"

void bind_mask(nb::module_&) {}
