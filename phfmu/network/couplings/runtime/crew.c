/* Threads that take parts of the master's work. */
#define _POSIX_C_SOURCE 200809L
#include "crew.h"

#include <stdatomic.h>

/* Locks are those of the system; threads are not started here. */
#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
typedef SRWLOCK lock_t;
typedef CONDITION_VARIABLE signal_t;
#define LOCK_INIT(l) InitializeSRWLock(l)
#define SIGNAL_INIT(s) InitializeConditionVariable(s)
#define LOCK(l) AcquireSRWLockExclusive(l)
#define UNLOCK(l) ReleaseSRWLockExclusive(l)
#define WAIT(s, l) SleepConditionVariableSRW(s, l, INFINITE, 0)
#define WAKE_ALL(s) WakeAllConditionVariable(s)
#define YIELD() SwitchToThread()
#else
#include <pthread.h>
#include <sched.h>
typedef pthread_mutex_t lock_t;
typedef pthread_cond_t signal_t;
#define LOCK_INIT(l) pthread_mutex_init(l, NULL)
#define SIGNAL_INIT(s) pthread_cond_init(s, NULL)
#define LOCK(l) pthread_mutex_lock(l)
#define UNLOCK(l) pthread_mutex_unlock(l)
#define WAIT(s, l) pthread_cond_wait(s, l)
#define WAKE_ALL(s) pthread_cond_broadcast(s)
#define YIELD() sched_yield()
#endif

#if defined(__x86_64__) || defined(__i386__)
#define PAUSE() __builtin_ia32_pause()
#elif defined(__aarch64__)
#define PAUSE() __asm__ volatile("yield")
#else
#define PAUSE() ((void)0)
#endif

/* Looks at a number that others change before a thread sleeps, since waking one takes as long as a trial may:
 * some 10 us on its own, then some 500 us in which it lets others run. */
#define LOOKS 400
#define YIELDS 1000

/* Parts are taken several at once, so that each thread comes back a few times. */
#define TURNS 8

typedef struct crew {
    ph_crew base;
    lock_t lock;
    signal_t work;
    signal_t done;
    atomic_int round; /* changed under the lock, as all without atomics */
    atomic_int next;
    atomic_int left; /* who help and have not finished this round */
    atomic_int stop;
    int helpers;
    int n;
    int block;
    void (*part)(void *, int);
    void *with;
} crew;

size_t ph_crew_size(void) {
    return sizeof(crew);
}

/* What a thread waits for: the next round, the end of this one. */
static int no_round(crew *c, int seen) {
    return atomic_load(&c->round) == seen && !atomic_load(&c->stop);
}

static int others_left(crew *c, int seen) {
    (void)seen;
    return atomic_load(&c->left) > 0;
}

/* Until there is nothing to wait for or a thread had better sleep. */
static void look(crew *c, int (*waits)(crew *, int), int seen) {
    for (int i = 0; i < LOOKS + YIELDS && waits(c, seen); i++)
        if (i < LOOKS)
            PAUSE();
        else
            YIELD();
}

static void take(crew *c) {
    for (;;) {
        const int first = atomic_fetch_add(&c->next, c->block), end = first + c->block;
        if (first >= c->n)
            return;
        for (int i = first; i < end && i < c->n; i++)
            c->part(c->with, i);
    }
}

static void each(ph_crew *of, int n, void (*part)(void *, int), void *with) {
    crew *c = (crew *)of;
    LOCK(&c->lock);
    c->n = n;
    c->block = n / (TURNS * (c->helpers + 1)) + 1;
    c->part = part;
    c->with = with;
    atomic_store(&c->next, 0);
    atomic_store(&c->left, c->helpers);
    atomic_fetch_add(&c->round, 1);
    WAKE_ALL(&c->work);
    UNLOCK(&c->lock);
    take(c);
    look(c, others_left, 0);
    LOCK(&c->lock);
    while (others_left(c, 0))
        WAIT(&c->done, &c->lock);
    UNLOCK(&c->lock);
}

ph_crew *ph_crew_init(void *memory) {
    crew *c = memory;
    c->base.each = each;
    LOCK_INIT(&c->lock);
    SIGNAL_INIT(&c->work);
    SIGNAL_INIT(&c->done);
    atomic_init(&c->round, 0);
    atomic_init(&c->next, 0);
    atomic_init(&c->left, 0);
    atomic_init(&c->stop, 0);
    c->helpers = 0;
    return &c->base;
}

void ph_crew_help(ph_crew *of) {
    crew *c = (crew *)of;
    int seen;
    LOCK(&c->lock);
    c->helpers++;
    seen = atomic_load(&c->round);
    UNLOCK(&c->lock);
    for (;;) {
        look(c, no_round, seen);
        LOCK(&c->lock);
        while (no_round(c, seen))
            WAIT(&c->work, &c->lock);
        if (atomic_load(&c->stop)) {
            c->helpers--;
            UNLOCK(&c->lock);
            return;
        }
        seen = atomic_load(&c->round);
        UNLOCK(&c->lock);
        take(c);
        if (atomic_fetch_sub(&c->left, 1) == 1) {
            LOCK(&c->lock);
            WAKE_ALL(&c->done);
            UNLOCK(&c->lock);
        }
    }
}

void ph_crew_end(ph_crew *of) {
    crew *c = (crew *)of;
    LOCK(&c->lock);
    atomic_store(&c->stop, 1);
    WAKE_ALL(&c->work);
    UNLOCK(&c->lock);
}
