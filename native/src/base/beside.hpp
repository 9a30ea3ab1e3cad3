// Two things at once: a computation in a thread of its own, beside what its caller does meanwhile. The page has one
// thread.
#pragma once
#include <type_traits>
#include <utility>

#if !defined(__wasm__)
#include <future>
#endif

namespace lidarcodec {

template <class Compute>
class Beside {
  using Result = std::invoke_result_t<Compute>;

 public:
  // Begins to compute. pays: whether it takes much longer than a thread takes to start, a twentieth of a millisecond,
  // and a processor is free (base/processor.hpp). Without that, or where no thread can be started, `get` computes.
#if defined(__wasm__)
  Beside(Compute compute, bool) : compute_(std::move(compute)) {}
#else
  Beside(Compute compute, bool pays)
      : result_(std::async(pays ? std::launch::async | std::launch::deferred : std::launch::deferred,
                           std::move(compute))) {}
#endif

  // The result, once; waits for it. Raises what the computation raised. The destructor waits, too.
  Result get() {
#if defined(__wasm__)
    return compute_();
#else
    return result_.get();
#endif
  }

 private:
#if defined(__wasm__)
  Compute compute_;
#else
  std::future<Result> result_;
#endif
};

}  // namespace lidarcodec
