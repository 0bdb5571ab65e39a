/* Frama-C's C library has none. */
#define SYS_futex 202
#define SYS_gettid 186
