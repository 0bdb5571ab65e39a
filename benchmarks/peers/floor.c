/* The baseline in C: two slots and a sequence number in shared memory. The reader spins or waits for a semaphore.
 *
 *   floor spin|event SIZE RATE SECONDS   prints the age of each sample in ns, then the CPU time in percent of a core
 */
#define _GNU_SOURCE
#include <semaphore.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

struct shared {
    _Atomic uint32_t last_number; /* of the newest complete sample; its parity selects the slot */
    _Atomic uint32_t stop;        /* 1: the writer has ended */
    sem_t event;
    uint64_t slots[];
};

/* Return the time in ns of the monotonic clock, which all processes share. */
static uint64_t now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000ull + t.tv_nsec;
}

int main(int argc, char **argv)
{
    if (argc != 5)
        return 2;
    int event = !strcmp(argv[1], "event");
    size_t size = strtoul(argv[2], 0, 10);
    double rate = atof(argv[3]), seconds = atof(argv[4]);
    struct shared *shared =
        mmap(0, sizeof *shared + 2 * size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    sem_init(&shared->event, 1, 0);
    uint64_t *sample = calloc(1, size);
    if (fork() == 0) {
        uint64_t period = 1e9 / rate, due = now();
        for (uint32_t number = 1; number <= seconds * rate; number++) {
            due += period;
            struct timespec due_time = {due / 1000000000, due % 1000000000};
            clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due_time, 0);
            sample[0] = now();
            memcpy((char *)shared->slots + number % 2 * size, sample, size);
            atomic_store(&shared->last_number, number);
            if (event)
                sem_post(&shared->event);
        }
        atomic_store(&shared->stop, 1);
        sem_post(&shared->event);
        _exit(0);
    }
    uint64_t start = now();
    for (uint32_t last = 0; !atomic_load(&shared->stop);) {
        if (event)
            sem_wait(&shared->event);
        uint32_t number = atomic_load(&shared->last_number);
        if (number == last)
            continue;
        memcpy(sample, (char *)shared->slots + number % 2 * size, size);
        printf("%lu\n", (unsigned long)(now() - sample[0]));
        last = number;
    }
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    double cpu_seconds =
        usage.ru_utime.tv_sec + usage.ru_stime.tv_sec + (usage.ru_utime.tv_usec + usage.ru_stime.tv_usec) / 1e6;
    printf("%f\n", cpu_seconds / ((now() - start) / 1e9) * 100);
    wait(0);
    return 0;
}
