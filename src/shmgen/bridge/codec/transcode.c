/* Turns payloads into the bytes that ROS sends of them, and back, by the steps of bridge/codec/steps.py: what is ordinary of what
 * transcode.py does. Each call does all or nothing: None is what the Python beside it is to look at.
 *
 * Made by hatch_build.py where there is a compiler; Python's limited API, so that one binary is for all versions. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

enum { NUMBERS, BOOLS, TEXTS, WIDE_TEXTS, CLOCKS, STAMP, MESSAGES, FILLER }; /* steps.CODES */
enum { TIME_MS, TIME_NS, TIME_PARTS, DURATION_MS, DURATION_NS, DURATION_PARTS }; /* steps.KINDS */

#define SECOND INT64_C(1000000000)
#define MILLISECOND INT64_C(1000000)
#define COME_ROUND (INT64_C(1) << 32) /* of TIME, in ms */

typedef struct {
    int code;
    size_t at, size, most;
    ptrdiff_t count_at; /* -1: always `most` */
    Py_ssize_t inner;
    int kind;
} Step;

typedef struct {
    PyObject_HEAD
    Step *steps;
    Py_ssize_t count;
    size_t size; /* of a payload */
    size_t most; /* bytes that it comes to in ROS, behind the head */
    bool is_ros1;
} Transcoder;

/* One call: the payload, ROS's bytes behind their head, and how far it is in those. What is written to has `room`. */
typedef struct {
    const Transcoder *self;
    unsigned char *payload, *wire;
    size_t at, room;
    int64_t stamp[2]; /* for a stamp of zero: seconds, nanoseconds */
} Way;

/* Passes over what goes before a number of `size` bytes; what is written is zero there. */
static bool align(Way *way, size_t size, bool writes)
{
    const size_t pad = way->self->is_ros1 ? 0 : (size - way->at % size) % size;
    if (pad > way->room - way->at)
        return false;
    if (writes)
        memset(way->wire + way->at, 0, pad);
    way->at += pad;
    return true;
}

static bool put(Way *way, const void *from, size_t size)
{
    if (size > way->room - way->at)
        return false;
    memcpy(way->wire + way->at, from, size);
    way->at += size;
    return true;
}

static bool put_u32(Way *way, uint32_t number)
{
    return align(way, 4, true) && put(way, &number, sizeof number);
}

static bool take(Way *way, void *into, size_t size)
{
    if (size > way->room - way->at)
        return false;
    memcpy(into, way->wire + way->at, size);
    way->at += size;
    return true;
}

static bool take_u32(Way *way, uint32_t *number)
{
    return align(way, 4, false) && take(way, number, sizeof *number);
}

static bool is_plain(const unsigned char *text, size_t length)
{
    for (size_t index = 0; index < length; index++)
        if (text[index] == 0 || text[index] > 127)
            return false;
    return true;
}

static bool are_bools(const unsigned char *bytes, size_t count)
{
    for (size_t index = 0; index < count; index++)
        if (bytes[index] > 1)
            return false;
    return true;
}

/* Of a time in the region: seconds and nanoseconds. False: it says nothing, and is a stamp. */
static bool parts_of(const unsigned char *from, const Step *step, int64_t parts[2])
{
    int32_t seconds;
    uint32_t low;
    uint64_t whole;
    struct timespec now;
    int64_t ms;
    switch (step->kind) {
    case TIME_PARTS:
    case DURATION_PARTS:
        memcpy(&seconds, from, sizeof seconds);
        memcpy(&low, from + 4, sizeof low);
        parts[0] = seconds;
        parts[1] = low;
        return seconds != 0 || low != 0;
    case TIME_NS:
    case DURATION_NS:
        memcpy(&whole, from, sizeof whole);
        parts[0] = (int64_t)(whole / (uint64_t)SECOND);
        parts[1] = (int64_t)(whole % (uint64_t)SECOND);
        return whole != 0;
    default:
        memcpy(&low, from, sizeof low);
        ms = low;
        if (step->kind == TIME_MS && low != 0) { /* the instant nearest to now */
            clock_gettime(CLOCK_REALTIME, &now);
            ms = (int64_t)now.tv_sec * 1000 + now.tv_nsec / MILLISECOND;
            ms += (((int64_t)low - ms + COME_ROUND / 2) % COME_ROUND + COME_ROUND) % COME_ROUND - COME_ROUND / 2;
        }
        parts[0] = ms / 1000;
        parts[1] = ms % 1000 * MILLISECOND;
        return low != 0;
    }
}

/* False: ROS, or the region, has no such time. */
static bool put_clock(Way *way, const Step *step, const unsigned char *from)
{
    const bool is_time = step->kind <= TIME_PARTS, is_ros1 = way->self->is_ros1;
    int64_t parts[2];
    int32_t seconds;
    uint32_t words[2];
    if (!parts_of(from, step, parts) && step->code == STAMP)
        memcpy(parts, way->stamp, sizeof parts);
    if (parts[0] < (is_ros1 && is_time ? 0 : INT32_MIN) || parts[0] > (is_ros1 && is_time ? UINT32_MAX : INT32_MAX))
        return false;
    if (parts[1] < 0 || parts[1] > (is_ros1 && !is_time ? INT32_MAX : UINT32_MAX))
        return false;
    seconds = (int32_t)parts[0];
    words[0] = is_ros1 && is_time ? (uint32_t)parts[0] : (uint32_t)seconds;
    words[1] = (uint32_t)parts[1];
    return align(way, 4, true) && put(way, words, sizeof words);
}

static bool take_clock(Way *way, const Step *step, unsigned char *into)
{
    const bool is_ros1 = way->self->is_ros1, is_time = step->kind <= TIME_PARTS;
    uint32_t words[2], low;
    int64_t seconds, nanos, total, ms;
    if (!align(way, 4, false) || !take(way, words, sizeof words))
        return false;
    seconds = is_ros1 && is_time ? (int64_t)words[0] : (int64_t)(int32_t)words[0];
    nanos = is_ros1 && !is_time ? (int64_t)(int32_t)words[1] : (int64_t)words[1];
    total = seconds * SECOND + nanos;
    switch (step->kind) {
    case TIME_PARTS:
    case DURATION_PARTS:
        if (seconds > INT32_MAX || nanos < 0)
            return false;
        memcpy(into, words, sizeof words);
        return true;
    case TIME_NS:
    case DURATION_NS:
        if (total < 0)
            return false;
        memcpy(into, &total, sizeof total);
        return true;
    case TIME_MS:
        if (total < 0)
            return false;
        ms = total / MILLISECOND % COME_ROUND;
        low = ms != 0 || total == 0 ? (uint32_t)ms : 1; /* zero would say that it is unset */
        memcpy(into, &low, sizeof low);
        return true;
    default:
        if (total < 0 || total / MILLISECOND >= COME_ROUND)
            return false;
        low = (uint32_t)(total / MILLISECOND);
        memcpy(into, &low, sizeof low);
        return true;
    }
}

static bool put_text(Way *way, const Step *step, const unsigned char *from)
{
    const size_t length = strnlen((const char *)from, step->size);
    const bool ends = !way->self->is_ros1;
    return is_plain(from, length) && put_u32(way, (uint32_t)(length + ends)) && put(way, from, length) &&
           (!ends || put(way, "", 1));
}

static bool take_text(Way *way, const Step *step, unsigned char *into)
{
    const bool ends = !way->self->is_ros1;
    uint32_t length;
    if (!take_u32(way, &length) || length < ends || length - ends >= step->size)
        return false;
    if (!take(way, into, length - ends) || !is_plain(into, length - ends))
        return false;
    return !ends || (way->at < way->room && way->wire[way->at++] == 0);
}

static bool put_all(Way *way, Py_ssize_t first, Py_ssize_t last, const unsigned char *message)
{
    while (first < last) {
        const Step *step = &way->self->steps[first++];
        const unsigned char *from = message + step->at;
        size_t number = step->most;
        if (step->count_at >= 0) {
            uint32_t count;
            memcpy(&count, message + step->count_at, sizeof count);
            if (count > step->most || !put_u32(way, count))
                return false;
            number = count;
        }
        if (step->code == NUMBERS || step->code == BOOLS) {
            if (number != 0 && !(align(way, step->size, true) && put(way, from, number * step->size)))
                return false;
            if (step->code == BOOLS && !are_bools(from, number))
                return false;
        } else if (step->code == FILLER) {
            if (!way->self->is_ros1 && !put(way, "", 1))
                return false;
        } else {
            for (; number > 0; number--, from += step->size)
                if (!(step->code == MESSAGES ? put_all(way, first, first + step->inner, from)
                      : step->code == TEXTS  ? put_text(way, step, from)
                                             : step->code != WIDE_TEXTS && put_clock(way, step, from)))
                    return false;
            first += step->inner;
        }
    }
    return true;
}

static bool take_all(Way *way, Py_ssize_t first, Py_ssize_t last, unsigned char *message)
{
    while (first < last) {
        const Step *step = &way->self->steps[first++];
        unsigned char *into = message + step->at;
        size_t number = step->most;
        if (step->count_at >= 0) {
            uint32_t count;
            if (!take_u32(way, &count) || count > step->most)
                return false;
            memcpy(message + step->count_at, &count, sizeof count);
            number = count;
        }
        if (step->code == NUMBERS || step->code == BOOLS) {
            if (number != 0 && !(align(way, step->size, false) && take(way, into, number * step->size)))
                return false;
            if (step->code == BOOLS && !are_bools(into, number))
                return false;
        } else if (step->code == FILLER) {
            unsigned char filler;
            if (!way->self->is_ros1 && !take(way, &filler, 1))
                return false;
        } else {
            for (; number > 0; number--, into += step->size)
                if (!(step->code == MESSAGES ? take_all(way, first, first + step->inner, into)
                      : step->code == TEXTS  ? take_text(way, step, into)
                                             : step->code != WIDE_TEXTS && take_clock(way, step, into)))
                    return false;
            first += step->inner;
        }
    }
    return true;
}

/* Most bytes that some steps come to in ROS, each with what goes before it. */
static size_t most_of(const Transcoder *self, Py_ssize_t first, Py_ssize_t last)
{
    size_t most = 0;
    while (first < last) {
        const Step *step = &self->steps[first++];
        const size_t each = step->code == MESSAGES ? most_of(self, first, first + step->inner)
                            : step->code == NUMBERS ? step->size
                                                    : step->size + 12; /* alignment, length, a time's two words */
        most += 16 + step->most * each;
        first += step->inner;
    }
    return most;
}

/* Asks Python for the stamp, where there is one that is unset. False, and an exception: it failed. */
static bool stamped(Way *way, PyObject *now)
{
    for (Py_ssize_t index = 0; index < way->self->count; index++) {
        const Step *step = &way->self->steps[index];
        int64_t parts[2];
        if (step->code == STAMP && !parts_of(way->payload + step->at, step, parts)) {
            PyObject *time = PyObject_CallObject(now, NULL);
            long long seconds = 0, nanos = 0;
            const bool is_time = time != NULL && PyArg_ParseTuple(time, "LL", &seconds, &nanos);
            Py_XDECREF(time);
            way->stamp[0] = seconds;
            way->stamp[1] = nanos;
            return is_time;
        }
    }
    return true;
}

/* NULL: they are no bytes, or not as many as a payload has. */
static unsigned char *payload_of(const Transcoder *self, PyObject *payload)
{
    if (PyBytes_Check(payload) && (size_t)PyBytes_Size(payload) == self->size)
        return (unsigned char *)PyBytes_AsString(payload);
    if (PyByteArray_Check(payload) && (size_t)PyByteArray_Size(payload) == self->size)
        return (unsigned char *)PyByteArray_AsString(payload);
    return NULL;
}

static PyObject *transcoder_encode(PyObject *object, PyObject *arguments)
{
    const Transcoder *self = (Transcoder *)object;
    const size_t head = self->is_ros1 ? 0 : 4;
    Way way = {.self = self, .room = self->most};
    PyObject *payload, *now, *made = NULL;
    unsigned char *buffer;
    if (!PyArg_ParseTuple(arguments, "OO", &payload, &now))
        return NULL;
    way.payload = payload_of(self, payload);
    if (way.payload != NULL && !stamped(&way, now))
        return NULL;
    way.payload = payload_of(self, payload); /* once more: Python has run */
    if (way.payload == NULL)
        Py_RETURN_NONE;
    buffer = PyMem_Malloc(head + self->most);
    if (buffer == NULL)
        return PyErr_NoMemory();
    memcpy(buffer, "\0\1\0", head); /* of XCDR1, little-endian: four bytes with the NUL */
    way.wire = buffer + head;
    if (put_all(&way, 0, self->count, way.payload)) {
        made = PyBytes_FromStringAndSize((char *)buffer, (Py_ssize_t)(head + way.at));
    } else {
        made = Py_None;
        Py_INCREF(made);
    }
    PyMem_Free(buffer);
    return made;
}

static PyObject *transcoder_decode(PyObject *object, PyObject *data)
{
    const Transcoder *self = (Transcoder *)object;
    const size_t head = self->is_ros1 ? 0 : 4, rest = self->is_ros1 ? 0 : 3;
    Way way = {.self = self};
    PyObject *made;
    size_t size;
    unsigned char *bytes;
    if (!PyBytes_Check(data))
        Py_RETURN_NONE;
    size = (size_t)PyBytes_Size(data);
    bytes = (unsigned char *)PyBytes_AsString(data);
    if (size < head || (head != 0 && (bytes[0] != 0 || bytes[1] != 1)))
        Py_RETURN_NONE;
    made = PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)self->size);
    if (made == NULL)
        return NULL;
    way.wire = bytes + head;
    way.room = size - head;
    way.payload = (unsigned char *)PyByteArray_AsString(made);
    memset(way.payload, 0, self->size);
    if (take_all(&way, 0, self->count, way.payload) && way.room - way.at <= rest)
        return made;
    Py_DECREF(made);
    Py_RETURN_NONE;
}

static PyObject *transcoder_new(PyTypeObject *type, PyObject *arguments, PyObject *keywords)
{
    PyObject *steps;
    Py_ssize_t size;
    int is_ros1;
    Transcoder *self;
    (void)keywords;
    if (!PyArg_ParseTuple(arguments, "O!np", &PyList_Type, &steps, &size, &is_ros1))
        return NULL;
    self = (Transcoder *)((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0);
    if (self == NULL)
        return NULL;
    self->count = PyList_Size(steps);
    self->size = (size_t)size;
    self->is_ros1 = is_ros1;
    self->steps = PyMem_Calloc((size_t)self->count + 1, sizeof(Step));
    if (self->steps == NULL) {
        Py_DECREF(self);
        return PyErr_NoMemory();
    }
    for (Py_ssize_t index = 0; index < self->count; index++) {
        Step *step = &self->steps[index];
        Py_ssize_t at, bytes, most, count_at;
        if (!PyArg_ParseTuple(PyList_GetItem(steps, index), "innnnni", &step->code, &at, &bytes, &most, &count_at,
                              &step->inner, &step->kind)) {
            Py_DECREF(self);
            return NULL;
        }
        step->at = (size_t)at;
        step->size = (size_t)bytes;
        step->most = (size_t)most;
        step->count_at = (ptrdiff_t)count_at;
    }
    self->most = most_of(self, 0, self->count);
    return (PyObject *)self;
}

static void transcoder_free(PyObject *object)
{
    PyTypeObject *type = Py_TYPE(object);
    PyMem_Free(((Transcoder *)object)->steps);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(object);
    Py_DECREF(type);
}

static PyMethodDef methods[] = {
    {"encode", transcoder_encode, METH_VARARGS, NULL},
    {"decode", transcoder_decode, METH_O, NULL},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot slots[] = {
    {Py_tp_new, (void *)transcoder_new},
    {Py_tp_methods, methods},
    {Py_tp_dealloc, (void *)transcoder_free},
    {0, NULL},
};

static PyType_Spec specification = {"shmgen._transcode.Transcoder", (int)sizeof(Transcoder), 0, Py_TPFLAGS_DEFAULT, slots};

static int fill(PyObject *module)
{
    PyObject *type = PyType_FromSpec(&specification);
    if (type == NULL || PyModule_AddObject(module, "Transcoder", type) != 0) {
        Py_XDECREF(type);
        return -1;
    }
    return 0;
}

static PyModuleDef_Slot module_slots[] = {
    {Py_mod_exec, (void *)fill},
    {0, NULL},
};

static PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_transcode", NULL, 0, NULL, module_slots, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__transcode(void)
{
    return PyModuleDef_Init(&definition);
}
