/* Preloaded into a program, this lets every write at a place of a file wait while there is a file BAD_DISK_WHILE, and
   fail with an input/output error once BAD_DISK_WRITES have been made (0: never). */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdlib.h>
#include <sys/types.h>
#include <unistd.h>

static long number_of(const char *name) {
  const char *text = getenv(name);
  return text ? atol(text) : 0;
}

ssize_t pwrite(int file, const void *bytes, size_t size, off_t position) {
  static ssize_t (*real)(int, const void *, size_t, off_t);
  static long writes;
  if (!real) real = (ssize_t(*)(int, const void *, size_t, off_t))dlsym(RTLD_NEXT, "pwrite");
  const long most = number_of("BAD_DISK_WRITES");
  const char *gate = getenv("BAD_DISK_WHILE");
  while (gate && access(gate, F_OK) == 0) usleep(1000);
  if (most && writes++ >= most) {
    errno = EIO;
    return -1;
  }
  return real(file, bytes, size, position);
}
