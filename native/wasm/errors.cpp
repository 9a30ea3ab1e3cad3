// What a `throw` of the core becomes: a call of the host, which leaves the module for good by an exception of its own.
// So there are no tables for unwinding, and no destructors run: whoever hears of an error throws the module away.
#include <cstdint>
#include <cstdlib>
#include <exception>
#include <typeinfo>

#include "base/error.hpp"

extern "C" {

// Never returns. code: of ErrorCode, -1 for what the core does not throw; what: UTF-8 that ends with a zero.
[[noreturn]] __attribute__((import_module("lidarcodec"), import_name("failed"))) void host_failed(std::int32_t code,
                                                                                                  const char* what);

void* __cxa_allocate_exception(std::size_t size) noexcept { return std::malloc(size); }
void __cxa_free_exception(void*) noexcept {}

[[noreturn]] void __cxa_throw(void* thrown, std::type_info* type, void (*)(void*)) {
  if (*type == typeid(lidarcodec::Error)) {
    const auto& error = *static_cast<const lidarcodec::Error*>(thrown);
    host_failed(static_cast<std::int32_t>(error.code()), error.what());
  }
  host_failed(-1, type->name());
}

_Noreturn void abort() { host_failed(-1, "the decoder gave up"); }
}
