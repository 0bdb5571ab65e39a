/* The bytes of a message's structure out of any object with its attributes, and back (codec.c), for one call in C that
 * publishes or reads (core.c). A codec is an object of Python's, made by messages/plan.py. */
#ifndef SHMGEN_CODEC_H
#define SHMGEN_CODEC_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdbool.h>
#include <stddef.h>

/* Py_buffer as all Pythons from 3.3 on have it. The limited API shows it from 3.11 on; 3.10 has the functions too. */
#if defined(Py_LIMITED_API) && Py_LIMITED_API + 0 < 0x030B0000
typedef struct codec_buffer {
    void *buf;
    PyObject *obj;
    Py_ssize_t len;
    Py_ssize_t itemsize;
    int readonly;
    int ndim;
    char *format;
    Py_ssize_t *shape;
    Py_ssize_t *strides;
    Py_ssize_t *suboffsets;
    void *internal;
} codec_buffer;
#else
typedef Py_buffer codec_buffer;
#endif

#define CODEC_MOST_LATE 16
#define CODEC_LATE_FROM 4096 /* bytes of capacity: LATE_FROM of messages/message.py */

/* An array that is copied straight into the slot: `view.len` bytes of the `room` at `offset` of the message. It is
 * contiguous, and is not moved in memory before codec_release(). */
typedef struct codec_late {
    size_t offset;
    size_t room;
    codec_buffer view;
} codec_late;

int codec_fill(PyObject *module); /* adds the type */
bool codec_is(PyObject *object);

/* Both run code of the message's, which may call them again. 0: done. 1: not for C, and no exception is set: `_encode`
 * or `_decode` is to do it from the start, and says what is wrong. -1: an exception that is no Exception. */

/* Writes all bytes of the structure but the rooms of late arrays, of which `late` takes CODEC_MOST_LATE; `cuts` are the
 * texts that were cut. Else there are none of both, and all bytes are zero. */
int codec_encode(PyObject *codec, PyObject *message, unsigned char *into, codec_late *late, size_t *count,
                 size_t *cuts);
void codec_release(codec_late *late, size_t count);

/* `data` is not the region: it stays as it is meanwhile. */
int codec_decode(PyObject *codec, const unsigned char *data, PyObject *message);

#endif
