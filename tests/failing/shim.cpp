// Makes the n-th call of a kind fail, as SQLite's tests do it: what a program does then is tested on the program itself.
// Loaded with LD_PRELOAD; does nothing until `fail_arm` is called (tests/failing/shim.py).
#include <dlfcn.h>
#include <fcntl.h>
#include <link.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <new>

extern "C" {
void* __libc_malloc(std::size_t);
void* __libc_calloc(std::size_t, std::size_t);
void* __libc_realloc(void*, std::size_t);
}

namespace {

// What may fail: calls that change a disk; `operator new` of the native core; memory in large parts, whichever code asks.
enum Kind { kNothing, kDisk, kCore, kLarge };

constexpr std::size_t kLargeBytes = 64 * 1024;

std::atomic<int> armed{kNothing};
std::atomic<long> seen{0};
long fails_at = 0;
bool goes_on = false;
std::uintptr_t core_begins = 0, core_ends = 0;

// Whether this call of a kind is the one to fail.
bool fails(Kind kind) {
  if (armed.load(std::memory_order_relaxed) != kind) return false;
  const long number = ++seen;
  return number == fails_at || (goes_on && number > fails_at);
}

// What a program says it says even then: standard streams are left out.
bool on_disk(int handle) {
  struct stat about;
  return handle > 2 && fstat(handle, &about) == 0 && (S_ISREG(about.st_mode) || S_ISDIR(about.st_mode));
}

template <class F>
F next(const char* name) {
  return reinterpret_cast<F>(dlsym(RTLD_NEXT, name));
}

int no_space() {
  errno = ENOSPC;
  return -1;
}

int find_core(dl_phdr_info* info, std::size_t, void*) {
  if (std::strstr(info->dlpi_name, "lidarcodec/_native") == nullptr) return 0;
  core_begins = ~std::uintptr_t{0};
  for (int i = 0; i < info->dlpi_phnum; ++i) {
    const auto& part = info->dlpi_phdr[i];
    if (part.p_type != PT_LOAD) continue;
    core_begins = std::min<std::uintptr_t>(core_begins, info->dlpi_addr + part.p_vaddr);
    core_ends = std::max<std::uintptr_t>(core_ends, info->dlpi_addr + part.p_vaddr + part.p_memsz);
  }
  return 1;
}

// What `operator new` gives to code at this address; nullptr where it fails.
void* given(std::size_t size, std::size_t align, void* caller) {
  const auto at = reinterpret_cast<std::uintptr_t>(caller);
  if (at >= core_begins && at < core_ends && fails(kCore)) return nullptr;
  if (size == 0) size = 1;
  if (align <= alignof(std::max_align_t)) return std::malloc(size);
  void* found = nullptr;
  return posix_memalign(&found, align, size) == 0 ? found : nullptr;
}

void* or_throw(void* found) {
  if (found == nullptr) throw std::bad_alloc();
  return found;
}

}  // namespace

extern "C" {

// From now on the n-th call of a kind fails, and all after it if `on` is set. 0: nothing fails, calls are counted.
void fail_arm(int kind, long n, int on) {
  dl_iterate_phdr(find_core, nullptr);
  fails_at = n;
  goes_on = on != 0 && n > 0;
  seen = 0;
  armed = kind;
}

// Nothing fails any more. Calls of the kind since `fail_arm`.
long fail_disarm() {
  armed = kNothing;
  return seen;
}

void* malloc(std::size_t size) {
  if (size >= kLargeBytes && fails(kLarge)) {
    errno = ENOMEM;
    return nullptr;
  }
  return __libc_malloc(size);
}

void* calloc(std::size_t count, std::size_t size) {
  if (count != 0 && size >= kLargeBytes / count && fails(kLarge)) {
    errno = ENOMEM;
    return nullptr;
  }
  return __libc_calloc(count, size);
}

void* realloc(void* before, std::size_t size) {
  if (size >= kLargeBytes && fails(kLarge)) {
    errno = ENOMEM;
    return nullptr;
  }
  return __libc_realloc(before, size);
}

ssize_t write(int handle, const void* data, std::size_t size) {
  static const auto real = next<ssize_t (*)(int, const void*, std::size_t)>("write");
  return on_disk(handle) && fails(kDisk) ? no_space() : real(handle, data, size);
}

ssize_t writev(int handle, const iovec* parts, int count) {
  static const auto real = next<ssize_t (*)(int, const iovec*, int)>("writev");
  return on_disk(handle) && fails(kDisk) ? no_space() : real(handle, parts, count);
}

ssize_t pwrite64(int handle, const void* data, std::size_t size, off64_t at) {
  static const auto real = next<ssize_t (*)(int, const void*, std::size_t, off64_t)>("pwrite64");
  return on_disk(handle) && fails(kDisk) ? no_space() : real(handle, data, size, at);
}

int fsync(int handle) {
  static const auto real = next<int (*)(int)>("fsync");
  return fails(kDisk) ? no_space() : real(handle);
}

int fdatasync(int handle) {
  static const auto real = next<int (*)(int)>("fdatasync");
  return fails(kDisk) ? no_space() : real(handle);
}

int ftruncate64(int handle, off64_t size) {
  static const auto real = next<int (*)(int, off64_t)>("ftruncate64");
  return fails(kDisk) ? no_space() : real(handle, size);
}

int rename(const char* from, const char* to) {
  static const auto real = next<int (*)(const char*, const char*)>("rename");
  return fails(kDisk) ? no_space() : real(from, to);
}

int renameat(int at, const char* from, int other, const char* to) {
  static const auto real = next<int (*)(int, const char*, int, const char*)>("renameat");
  return fails(kDisk) ? no_space() : real(at, from, other, to);
}

int renameat2(int at, const char* from, int other, const char* to, unsigned flags) {
  static const auto real = next<int (*)(int, const char*, int, const char*, unsigned)>("renameat2");
  return fails(kDisk) ? no_space() : real(at, from, other, to, flags);
}

int link(const char* from, const char* to) {
  static const auto real = next<int (*)(const char*, const char*)>("link");
  return fails(kDisk) ? no_space() : real(from, to);
}

int linkat(int at, const char* from, int other, const char* to, int flags) {
  static const auto real = next<int (*)(int, const char*, int, const char*, int)>("linkat");
  return fails(kDisk) ? no_space() : real(at, from, other, to, flags);
}

int mkdir(const char* path, mode_t mode) {
  static const auto real = next<int (*)(const char*, mode_t)>("mkdir");
  return fails(kDisk) ? no_space() : real(path, mode);
}

int chmod(const char* path, mode_t mode) {
  static const auto real = next<int (*)(const char*, mode_t)>("chmod");
  return fails(kDisk) ? no_space() : real(path, mode);
}

int fchmodat(int at, const char* path, mode_t mode, int flags) {
  static const auto real = next<int (*)(int, const char*, mode_t, int)>("fchmodat");
  return fails(kDisk) ? no_space() : real(at, path, mode, flags);
}

#define OPENS(NAME, HEAD, GIVEN)                                                                 \
  int NAME HEAD {                                                                                \
    static const auto real = next<int (*) HEAD>(#NAME);                                          \
    va_list more;                                                                                \
    va_start(more, flags);                                                                       \
    const mode_t mode = (flags & (O_CREAT | __O_TMPFILE)) != 0 ? va_arg(more, mode_t) : mode_t{0}; \
    va_end(more);                                                                                \
    return (flags & O_CREAT) != 0 && fails(kDisk) ? no_space() : real GIVEN;                     \
  }
OPENS(open, (const char* path, int flags, ...), (path, flags, mode))
OPENS(open64, (const char* path, int flags, ...), (path, flags, mode))
OPENS(openat, (int at, const char* path, int flags, ...), (at, path, flags, mode))
OPENS(openat64, (int at, const char* path, int flags, ...), (at, path, flags, mode))

}  // extern "C"

void* operator new(std::size_t size) { return or_throw(given(size, 1, __builtin_return_address(0))); }
void* operator new[](std::size_t size) { return or_throw(given(size, 1, __builtin_return_address(0))); }
void* operator new(std::size_t size, const std::nothrow_t&) noexcept { return given(size, 1, __builtin_return_address(0)); }
void* operator new[](std::size_t size, const std::nothrow_t&) noexcept { return given(size, 1, __builtin_return_address(0)); }
void* operator new(std::size_t size, std::align_val_t align) {
  return or_throw(given(size, static_cast<std::size_t>(align), __builtin_return_address(0)));
}
void* operator new[](std::size_t size, std::align_val_t align) {
  return or_throw(given(size, static_cast<std::size_t>(align), __builtin_return_address(0)));
}
