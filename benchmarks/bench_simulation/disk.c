/* Calls that change a file below one folder pass a function first, which says what becomes of them.
   Loaded by LD_PRELOAD (Linux). The function gets the call, descriptor, bytes, length and place, and answers
   0: do it; n > 0: do the first n bytes only; -1000: say that it was done; other n < 0: refuse with errno -n. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <string.h>
#include <sys/statvfs.h>
#include <sys/types.h>
#include <unistd.h>

enum { WRITE, TRUNCATE, SYNC, RENAME, UNLINK, OPEN };
typedef long (*hook_t)(int call, int fd, const void *bytes, long n, long at);
static hook_t hook;
static char folder[256];
static unsigned long long free_bytes;
static unsigned char ours[65536];
static __thread int inside;

void disk_watch(hook_t h, const char *f) { strncpy(folder, f, sizeof folder - 1); hook = h; }
void disk_free(unsigned long long n) { free_bytes = n; }

#define REAL(type, name, ...) static type (*real)(__VA_ARGS__); if (!real) real = (type (*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)
static int below(const char *path) { return hook && path && folder[0] && !strncmp(path, folder, strlen(folder)); }
static int is_ours(int fd) { return hook && !inside && fd >= 0 && fd < 65536 && ours[fd]; }
static long ask(int call, int fd, const void *bytes, long n, long at)
{
    inside = 1;
    long verdict = hook(call, fd, bytes, n, at);
    inside = 0;
    if (verdict < 0 && verdict != -1000) errno = (int)-verdict;
    return verdict;
}

#define WRITE_AT(name, off) \
ssize_t name(int fd, const void *bytes, size_t n, off at) { \
    REAL(ssize_t, #name, int, const void *, size_t, off); \
    if (!is_ours(fd)) return real(fd, bytes, n, at); \
    long v = ask(WRITE, fd, bytes, (long)n, (long)at); \
    return v == 0 ? real(fd, bytes, n, at) : v > 0 ? real(fd, bytes, (size_t)v, at) : v == -1000 ? (ssize_t)n : -1; }
WRITE_AT(pwrite, off_t)
WRITE_AT(pwrite64, off64_t)

ssize_t write(int fd, const void *bytes, size_t n)
{
    REAL(ssize_t, "write", int, const void *, size_t);
    if (!is_ours(fd)) return real(fd, bytes, n);
    off_t at = lseek(fd, 0, SEEK_CUR);
    if (fcntl(fd, F_GETFL) & O_APPEND) at = lseek(fd, 0, SEEK_END);
    long v = ask(WRITE, fd, bytes, (long)n, (long)at);
    if (v == -1000) { lseek(fd, (off_t)n, SEEK_CUR); return (ssize_t)n; }
    return v == 0 ? real(fd, bytes, n) : v > 0 ? real(fd, bytes, (size_t)v) : -1;
}

#define ON_FD(name, call, ...) \
    REAL(int, #name, __VA_ARGS__); \
    if (!is_ours(fd)) return real ARGUMENTS; \
    long v = ask(call, fd, 0, 0, (long)LENGTH); \
    return v == 0 ? real ARGUMENTS : v == -1000 ? 0 : -1
#define ARGUMENTS (fd, n)
#define LENGTH n
int ftruncate(int fd, off_t n) { ON_FD(ftruncate, TRUNCATE, int, off_t); }
int ftruncate64(int fd, off64_t n) { ON_FD(ftruncate64, TRUNCATE, int, off64_t); }
#undef ARGUMENTS
#undef LENGTH
#define ARGUMENTS (fd)
#define LENGTH 0
int fsync(int fd) { ON_FD(fsync, SYNC, int); }
int fdatasync(int fd) { ON_FD(fdatasync, SYNC, int); }

static int opened(int fd, const char *path) { if (fd >= 0 && fd < 65536) ours[fd] = (unsigned char)below(path); return fd; }
static int may_open(const char *path, int flags)
{
    if (!below(path) || inside || !(flags & (O_WRONLY | O_RDWR | O_CREAT | O_TRUNC))) return 1;
    return ask(OPEN, -1, path, (long)strlen(path), flags) == 0;
}
#define OPEN_BY(name) \
int name(const char *path, int flags, ...) { \
    REAL(int, #name, const char *, int, ...); \
    va_list more; va_start(more, flags); int mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, int) : 0; va_end(more); \
    return may_open(path, flags) ? opened(real(path, flags, mode), path) : -1; }
OPEN_BY(open)
OPEN_BY(open64)

int close(int fd) { REAL(int, "close", int); if (fd >= 0 && fd < 65536) ours[fd] = 0; return real(fd); }
int dup2(int from, int to)
{
    REAL(int, "dup2", int, int);
    if (from >= 0 && from < 65536 && to >= 0 && to < 65536) ours[to] = ours[from];
    return real(from, to);
}
int dup3(int from, int to, int flags)
{
    REAL(int, "dup3", int, int, int);
    if (from >= 0 && from < 65536 && to >= 0 && to < 65536) ours[to] = ours[from];
    return real(from, to, flags);
}

int rename(const char *from, const char *to)
{
    REAL(int, "rename", const char *, const char *);
    if (!below(from) || inside) return real(from, to);
    long v = ask(RENAME, -1, from, (long)strlen(from), 0);
    return v == 0 ? real(from, to) : v == -1000 ? 0 : -1;
}
int unlink(const char *path)
{
    REAL(int, "unlink", const char *);
    if (!below(path) || inside) return real(path);
    long v = ask(UNLINK, -1, path, (long)strlen(path), 0);
    return v == 0 ? real(path) : v == -1000 ? 0 : -1;
}

#define SPACE_BY(name, type) \
int name(const char *path, struct type *s) { \
    REAL(int, #name, const char *, struct type *); \
    int done = real(path, s); \
    if (!done && below(path) && free_bytes) s->f_bavail = s->f_bfree = free_bytes / s->f_frsize; \
    return done; }
SPACE_BY(statvfs, statvfs)
SPACE_BY(statvfs64, statvfs64)
