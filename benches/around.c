/* What stands around the service, put between it and the C library (LD_PRELOAD) by `python -m benches.chaos`: a disk below $AROUND_DISK
   that hangs or is full, and a wall clock that is set. The bench writes the present state into the file $AROUND_STATE. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

static volatile struct {
    int32_t hangs, full;
    int64_t ahead_s;
} *state;
static const char *disk;
static ssize_t (*real_write)(int, const void *, size_t);
static int (*real_fsync)(int);
static int (*real_clock)(clockid_t, struct timespec *);

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("AROUND_STATE");
    int fd = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    void *shared = fd < 0 ? MAP_FAILED : mmap(NULL, sizeof *state, PROT_READ, MAP_SHARED, fd, 0);
    disk = getenv("AROUND_DISK");
    real_write = dlsym(RTLD_NEXT, "write");
    real_fsync = dlsym(RTLD_NEXT, "fsync");
    real_clock = dlsym(RTLD_NEXT, "clock_gettime");
    state = shared == MAP_FAILED || !disk ? NULL : shared;
    if (fd >= 0) close(fd);
}

/* Wait while the disk hangs; return whether it is full. */
static int refuses(int fd) {
    char link[64], path[512];
    if (!state || fd <= 2 || !(state->hangs || state->full)) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n <= 0 || strncmp(path, disk, strlen(disk)) != 0) return 0;
    while (state->hangs) usleep(20000);
    return state->full;
}

ssize_t write(int fd, const void *data, size_t size) {
    if (refuses(fd)) {
        errno = ENOSPC;
        return -1;
    }
    return real_write(fd, data, size);
}

int fsync(int fd) {
    refuses(fd);
    return real_fsync(fd);
}

int clock_gettime(clockid_t which, struct timespec *now) {
    int result = real_clock ? real_clock(which, now) : -1;
    if (result == 0 && which == CLOCK_REALTIME && state) now->tv_sec += state->ahead_s;
    return result;
}
