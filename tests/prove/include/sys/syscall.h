/* The numbers of system calls, which Frama-C's C library lacks. */
#define SYS_futex 202
#define SYS_gettid 186
