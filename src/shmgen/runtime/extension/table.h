/* The table of a generated class (docs/layout.md). The table drives two conversions of the bytes of a message: to
 * the attributes of any object and back (objects.c), and to the serialization of ROS and back (wire.c).
 *
 * In Python, runtime/messages/walker.py and wire.py do the same. The extension passes each unusual value to a
 * function of walker.py. So all error messages are there, and no attribute is evaluated twice. */
#ifndef SHMGEN_TABLE_H
#define SHMGEN_TABLE_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Py_buffer, unchanged since Python 3.3. The limited API declares it from 3.11 on, but Python 3.10 has the
 * functions. */
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
PyAPI_FUNC(int) PyObject_GetBuffer(PyObject *object, codec_buffer *view, int flags);
PyAPI_FUNC(int) PyBuffer_IsContiguous(const codec_buffer *view, char order);
PyAPI_FUNC(int) PyBuffer_ToContiguous(void *into, const codec_buffer *view, Py_ssize_t length, char order);
PyAPI_FUNC(void) PyBuffer_Release(codec_buffer *view);
#define PyBUF_SIMPLE 0
#define PyBUF_WRITABLE 1
#define PyBUF_FORMAT 4
#define PyBUF_ND 8
#define PyBUF_FULL_RO 0x11C
#else
typedef Py_buffer codec_buffer;
#endif

#define CODEC_MOST_DEFERRED 16   /* maximum number of arrays that are copied directly into the slot */
#define CODEC_LATE_FROM 4096 /* capacity in bytes from which an array is copied directly into the slot */

/* The kinds of fields: numbers, strings, times and nested messages. */
enum { NUMBERS, TEXTS, CLOCKS, MESSAGES };

/* The names, types and functions in TOOLS of walker.py, in the same order. */
enum {
    SEC,
    NANOSEC,
    SECS,
    NSECS,
    COPY_METHOD,
    FROM_BUFFER_COPY,
    TIME,
    DURATION,
    NAMESPACE,
    REJECTED,
    COPY,
    NEW_LIKE,
    DECODE_NUMBERS,
    NUMBER_ARRAY,
    SEQUENCE,
    ELEMENT,
    MISSING,
    NESTED,
    TOO_MANY,
    REFUSE,
    TOOLS
};

/* A field. The steps of a nested message follow its own step. The member `references` of the table keeps all objects
 * except `known` alive. */
typedef struct Step {
    PyObject *row;       /* the Step object in Python */
    PyObject *name;      /* name of the attribute */
    PyObject *kind;      /* name of the kind, or the class of a nested message */
    PyTypeObject *known; /* a sequence type that DECODE_NUMBERS preserves; a strong reference */
    size_t at;           /* offset in the message that contains the field, in bytes */
    size_t size;         /* size of one element in bytes */
    size_t length;       /* number of elements; 0 = not an array */
    Py_ssize_t count_at; /* offset of the count of a sequence; -1 = none */
    Py_ssize_t inner;    /* number of steps of a nested message */
    size_t unit;         /* size of the numbers in bytes, if the step contains only numbers of one size, without padding */
    size_t run;          /* number of numbers of this step and next steps of equal `unit`, if they are contiguous */
    Py_ssize_t run_end;  /* distance to the last of these steps */
    int what;
    char code, family; /* numbers: as in Python's struct; strings: u, l, w; times: T, D in ms, N in ns, P in s and ns */
    bool truncates, is_duration;
} Step;

static inline size_t element_count(const Step *step)
{
    return step->length != 0 ? step->length : 1;
}

/* Return true for an array that is copied directly into the slot. */
static inline bool is_deferred(const Step *step)
{
    return step->what == NUMBERS && step->size * step->length >= CODEC_LATE_FROM;
}

/* The steps of a class and of its nested messages. */
typedef struct Table {
    PyObject_HEAD
    Step *steps;
    Py_ssize_t count;
    size_t size;
    size_t wire_most; /* maximum size of the serialized message in bytes, without its head */
    bool has_deferred;
    PyObject *tools[TOOLS];
    PyObject *references;
} Table;

/* An array that is copied directly into the slot: `view.len` bytes, of at most `room`, at `offset` in the message.
 * The array is contiguous, and its memory stays valid until codec_release(). */
typedef struct codec_deferred {
    size_t offset;
    size_t room;
    codec_buffer view;
} codec_deferred;

extern PyType_Spec table_type;

/* Both functions run Python code of the message, which may call the functions again. False means that an exception is
 * set. */

/* Encode a message into `into`, except large arrays, which `deferred` returns (up to CODEC_MOST_DEFERRED). `count` is
 * their number, and `cuts` the number of truncated strings. After a failure `count` is 0. */
bool codec_encode(PyObject *table, PyObject *message, unsigned char *into, codec_deferred *deferred, size_t *count,
                  size_t *cuts);
void codec_release(codec_deferred *deferred, size_t count);

/* Decode `data` into the attributes of a message. `data` must not change meanwhile, so it must not be the region. */
bool codec_decode(PyObject *table, const unsigned char *data, PyObject *message);

/* --- between table.c, objects.c and wire.c ------------------------------------------------------------------- */

/* Set the error that a tool raises, and return false. `index` is the index of an element, or -1 for a single field. */
bool refuse(const Table *self, const Step *step, Py_ssize_t index, const char *reason);
bool refuse_count(const Table *self, const Step *step, size_t count);
bool add_path(const Table *self, const Step *step, Py_ssize_t index); /* adds to the present error */

/* Clear the error of a value that walker.py will handle. Return false for errors that are not an Exception, such as
 * KeyboardInterrupt. */
bool clear_misfit(void);

bool put_text(const Step *step, unsigned char *into, PyObject *value, size_t *cuts);
PyObject *text_from(const Step *step, const unsigned char *from);
bool put_parts(const Step *step, unsigned char *into, int64_t seconds, int64_t nanos);
void parts_from(const Step *step, const unsigned char *from, int64_t *seconds, int64_t *nanos);
bool put_by_python(const Table *self, const Step *step, unsigned char *into, PyObject *value, Py_ssize_t index);

PyObject *table_to_wire(PyObject *table, PyObject *const *arguments, Py_ssize_t count);
PyObject *table_from_wire(PyObject *table, PyObject *const *arguments, Py_ssize_t count);
size_t wire_most(const Step *step, const Step *end);

#endif
