// From the n-th thread on (THREADS_LEFT = n - 1) the system gives none, as a limit of processes does.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>

int pthread_create(pthread_t* thread, const pthread_attr_t* how, void* (*run)(void*), void* with) {
  static int (*real)(pthread_t*, const pthread_attr_t*, void* (*)(void*), void*);
  static atomic_int made;
  if (real == NULL) real = (int (*)(pthread_t*, const pthread_attr_t*, void* (*)(void*), void*))dlsym(RTLD_NEXT, "pthread_create");
  const char* left = getenv("THREADS_LEFT");
  if (left != NULL && atomic_fetch_add(&made, 1) >= atoi(left)) return EAGAIN;
  return real(thread, how, run, with);
}
