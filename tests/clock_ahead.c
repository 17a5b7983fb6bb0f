/* Preloaded into a program, this lets its wall clock be ahead by CLOCK_AHEAD_S seconds (negative: behind), and nothing
   else: what waits, waits as long as before. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>

static const long SECOND_NS = 1000000000L;

int clock_gettime(clockid_t clock, struct timespec *now) {
  static int (*real)(clockid_t, struct timespec *);
  if (!real) real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
  const int result = real(clock, now);
  const char *text = getenv("CLOCK_AHEAD_S");
  if (result == 0 && text && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) {
    const long ns = now->tv_nsec + (long)(atof(text) * SECOND_NS);
    const long carry = ns >= 0 ? ns / SECOND_NS : -((SECOND_NS - 1 - ns) / SECOND_NS);
    now->tv_sec += carry;
    now->tv_nsec = ns - carry * SECOND_NS;
  }
  return result;
}

int gettimeofday(struct timeval *now, void *zone) {
  struct timespec exact;
  (void)zone;
  clock_gettime(CLOCK_REALTIME, &exact);
  now->tv_sec = exact.tv_sec;
  now->tv_usec = exact.tv_nsec / 1000;
  return 0;
}

time_t time(time_t *result) {
  struct timespec exact;
  clock_gettime(CLOCK_REALTIME, &exact);
  if (result) *result = exact.tv_sec;
  return exact.tv_sec;
}
