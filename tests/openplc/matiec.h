/* A stand-in for the type headers of matiec. SHMGEN_TEST_LENGTH and SHMGEN_TEST_SECONDS select Beremiz or OpenPLC v3. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _IEC_STD_LIB_H
typedef union { /* OpenPLC v3 declares a type of this name before it includes c_blocks.h */
    long tv_sec;
} tm;
#include "c_blocks.h"
#endif

typedef uint8_t BOOL;
typedef int8_t SINT;
typedef int16_t INT;
typedef int32_t DINT;
typedef int64_t LINT;
typedef uint8_t USINT;
typedef uint16_t UINT;
typedef uint32_t UDINT;
typedef uint64_t ULINT;
typedef float REAL;
typedef double LREAL;
typedef struct {
    SHMGEN_TEST_SECONDS tv_sec;
    SHMGEN_TEST_SECONDS tv_nsec;
} TIME;
typedef struct {
    SHMGEN_TEST_LENGTH len;
    uint8_t body[126];
} STRING;

static inline TIME seconds(int number)
{
    TIME time = {number, 0};
    return time;
}

#define number(value) ((double)(value))
#define put_time(place, v) ((place).tv_sec = (SHMGEN_TEST_SECONDS)(v), (place).tv_nsec = (SHMGEN_TEST_SECONDS)(((v) - (int)(v)) * 1e9))
#define put_text(place, v) ((place).len = (SHMGEN_TEST_LENGTH)strlen(v), (void)memcpy((place).body, v, strlen(v)))

#ifdef __cplusplus
#define SHMGEN_TEST_EXPORT extern "C"
#else
#define SHMGEN_TEST_EXPORT
#endif
