/* A system clock that a test can set, for processes that are started with this library preloaded.
 *
 * The offset [ns] is the first eight bytes of the file STEPPED_CLOCK. It is added to CLOCK_REALTIME and shifts
 * every wait until a time of it, also those in progress, as in the kernel; steady clocks are not changed.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>

#define SECOND 1000000000LL
#define SLICE 5000000LL /* latency until a wait in progress observes the step [ns] */

#define AGES 1000000000LL /* [s]: 2001 on the system clock, more than the uptime of any machine on the steady clock */

static const int64_t nothing = 0;
static volatile const int64_t *offset = &nothing;
static int (*real_gettime)(clockid_t, struct timespec *);
static int (*real_cond)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
static int (*real_sem)(sem_t *, const struct timespec *);
static int (*real_lock)(pthread_mutex_t *, const struct timespec *);

__attribute__((constructor)) static void begin(void)
{
    real_gettime = dlsym(RTLD_NEXT, "clock_gettime");
    real_cond = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    if (!real_cond)
        real_cond = dlsym(RTLD_NEXT, "pthread_cond_timedwait");
    real_sem = dlsym(RTLD_NEXT, "sem_timedwait");
    real_lock = dlsym(RTLD_NEXT, "pthread_mutex_timedlock");
    const char *path = getenv("STEPPED_CLOCK");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (file >= 0) {
        void *page = mmap(NULL, sizeof *offset, PROT_READ, MAP_SHARED, file, 0);
        if (page != MAP_FAILED)
            offset = page;
    }
}

static int64_t ns(const struct timespec *t) { return t->tv_sec * SECOND + t->tv_nsec; }

static struct timespec spec(int64_t t)
{
    struct timespec out = {t / SECOND, t % SECOND};
    return out;
}

int clock_gettime(clockid_t clock, struct timespec *t)
{
    if (!real_gettime)
        begin();
    int result = real_gettime(clock, t);
    if (result == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
        *t = spec(ns(t) + *offset);
    return result;
}

int gettimeofday(struct timeval *t, void *zone)
{
    (void)zone;
    struct timespec now;
    int result = clock_gettime(CLOCK_REALTIME, &now);
    t->tv_sec = now.tv_sec;
    t->tv_usec = now.tv_nsec / 1000;
    return result;
}

time_t time(time_t *t)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (t)
        *t = now.tv_sec;
    return now.tv_sec;
}

/* Set `until` to the end of the next slice of a wait until `end`, on the kernel clock; return whether it is the last. */
static int slice(const struct timespec *end, struct timespec *until)
{
    struct timespec now;
    real_gettime(CLOCK_REALTIME, &now);
    int64_t left = ns(end) - (ns(&now) + *offset);
    *until = spec(ns(&now) + (left < SLICE ? (left < 0 ? 0 : left) : SLICE));
    return left <= SLICE;
}

int pthread_cond_timedwait(pthread_cond_t *cond, pthread_mutex_t *mutex, const struct timespec *end)
{
    struct timespec until;
    int last, result;
    if (end->tv_sec < AGES) /* a wait on the steady clock */
        return real_cond(cond, mutex, end);
    do {
        last = slice(end, &until);
        result = real_cond(cond, mutex, &until);
    } while (result == ETIMEDOUT && !last);
    return result;
}

int sem_timedwait(sem_t *sem, const struct timespec *end)
{
    struct timespec until;
    int last, result;
    do {
        last = slice(end, &until);
        result = real_sem(sem, &until);
    } while (result == -1 && errno == ETIMEDOUT && !last);
    return result;
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *end)
{
    struct timespec until;
    int last, result;
    do {
        last = slice(end, &until);
        result = real_lock(mutex, &until);
    } while (result == ETIMEDOUT && !last);
    return result;
}
