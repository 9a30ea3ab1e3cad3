// Gives a process another time of day: OTHER_CLOCK = "SHIFT_S RATE JUMP_S", seconds that it is ahead, how many times as
// fast it goes, and how far it jumps ahead and back with each second. All other clocks stay right.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>

static int (*right)(clockid_t, struct timespec*);
static double begin_s, shift_s, rate = 1, jump_s;

__attribute__((constructor)) static void start(void) {
  right = (int (*)(clockid_t, struct timespec*))dlsym(RTLD_NEXT, "clock_gettime");
  const char* given = getenv("OTHER_CLOCK");
  if (given != NULL) sscanf(given, "%lf %lf %lf", &shift_s, &rate, &jump_s);
  struct timespec now;
  right(CLOCK_REALTIME, &now);
  begin_s = now.tv_sec + 1e-9 * now.tv_nsec;
}

static double other_s(void) {
  struct timespec now;
  right(CLOCK_REALTIME, &now);
  const double passed_s = now.tv_sec + 1e-9 * now.tv_nsec - begin_s;
  return begin_s + shift_s + rate * passed_s + ((long)passed_s % 2 ? jump_s : 0);
}

int clock_gettime(clockid_t clock, struct timespec* to) {
  if (right == NULL) start();  // a library asked before this one was ready
  if (clock != CLOCK_REALTIME && clock != CLOCK_REALTIME_COARSE) return right(clock, to);
  const double now_s = other_s();
  to->tv_sec = (time_t)now_s;
  to->tv_nsec = (long)(1e9 * (now_s - (double)to->tv_sec));
  return 0;
}

int gettimeofday(struct timeval* restrict to, void* restrict zone) {
  (void)zone;
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  to->tv_sec = now.tv_sec;
  to->tv_usec = now.tv_nsec / 1000;
  return 0;
}

time_t time(time_t* to) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (to != NULL) *to = now.tv_sec;
  return now.tv_sec;
}
