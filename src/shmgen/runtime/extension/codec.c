/* Turns a message into the bytes of its structure, and those bytes back into attributes, by the steps of
 * messages/plan.py: what is ordinary of what generated `_encode` and `_decode` do, which are the readable statement of
 * it. What is not, and all that is wrong, is theirs, and so is every error's text.
 *
 * Attributes, numbers and buffers may be any code of the user's: whatever is held across a call of such is owned.
 * CPython's limited API: one binary for 3.10 and all later. */
#include "codec.h"

#include <math.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

#if defined(Py_LIMITED_API) && Py_LIMITED_API + 0 < 0x030B0000
PyAPI_FUNC(int) PyObject_GetBuffer(PyObject *object, codec_buffer *view, int flags);
PyAPI_FUNC(int) PyBuffer_IsContiguous(const codec_buffer *view, char order);
PyAPI_FUNC(int) PyBuffer_ToContiguous(void *into, const codec_buffer *view, Py_ssize_t length, char order);
PyAPI_FUNC(void) PyBuffer_Release(codec_buffer *view);
#define PyBUF_SIMPLE 0
#define PyBUF_WRITABLE 1
#define PyBUF_FORMAT 4
#define PyBUF_ND 8
#define PyBUF_FULL_RO 0x11C
#endif
#define PyBUF_OF_ARRAY (PyBUF_WRITABLE | PyBUF_FORMAT | PyBUF_ND) /* in C's order */

#define SECOND INT64_C(1000000000)
#define MILLISECOND INT64_C(1000000)
#define COME_ROUND (INT64_C(1) << 32) /* of TIME, in ms */

enum { NUMBERS, TEXTS, CLOCKS, MESSAGES };

/* One attribute of a message, or of an element of a list of such; the steps of a nested message follow its own. Its
 * objects are the plan's. */
typedef struct Step {
    PyObject *name;
    PyObject *code_text;
    PyObject *kind;      /* of a time or a nested message: our class */
    PyTypeObject *known; /* that from_numbers() makes one of where the attribute is one; owned */
    size_t at;           /* offset in the message that it is an attribute of */
    size_t size;         /* of one element */
    size_t most;         /* elements; 0: no array */
    Py_ssize_t count_at; /* offset of the count of an array with a bound; -1: none */
    Py_ssize_t inner;    /* steps of a nested message */
    int what;
    char code, family;
    bool cuts; /* a text that is too long */
} Step;

/* What plan.py hands in. */
enum { SEC, NANOSEC, SECS, NSECS, COPY_METHOD, FROM_BUFFER_COPY, COPY, NEW_LIKE, FROM_NUMBERS, TIME, DURATION, NAMESPACE, TOOLS };

typedef struct Codec {
    PyObject_HEAD
    Step *steps;
    Py_ssize_t count;
    size_t size;
    bool has_late;
    PyObject *plan;
    PyObject *tools[TOOLS]; /* in `held` */
    PyObject *held;
} Codec;

/* One call of codec_encode(). */
typedef struct Way {
    const Codec *self;
    unsigned char *start;
    codec_late *late;
    size_t count;
    size_t cuts;
} Way;

static bool put_all(Way *way, const Step *step, const Step *end, unsigned char *into, PyObject *message);
static bool take_all(const Codec *self, Step *step, const Step *end, const unsigned char *from, PyObject *message);

/* That of a SimpleNamespace, which has all attributes there, since its type cannot change: half the time of asking the
 * object. NULL: it is another. */
static PyObject *dictionary_of(const Codec *self, PyObject *message)
{
    PyObject *found = NULL;
    if ((PyObject *)Py_TYPE(message) == self->tools[NAMESPACE] && (found = PyObject_GenericGetDict(message, NULL)) == NULL)
        PyErr_Clear();
    return found;
}

static PyObject *get(PyObject *message, PyObject *dictionary, PyObject *name)
{
    PyObject *value = dictionary != NULL ? PyDict_GetItemWithError(dictionary, name) : NULL;
    Py_XINCREF(value);
    return value != NULL || PyErr_Occurred() != NULL ? value : PyObject_GetAttr(message, name);
}

static bool set(PyObject *message, PyObject *dictionary, PyObject *name, PyObject *value)
{
    return (dictionary != NULL ? PyDict_SetItem(dictionary, name, value) : PyObject_SetAttr(message, name, value)) == 0;
}

static char family(char code)
{
    if (strchr("bhilqn", code) != NULL)
        return 'i';
    if (strchr("BHILQNc", code) != NULL)
        return 'u';
    return strchr("fd", code) != NULL ? 'f' : code;
}

static bool is_late(const Step *step)
{
    return step->what == NUMBERS && step->size * step->most >= CODEC_LATE_FROM;
}

/* Zero for all but the rooms of late arrays. */
static void clear(const Step *step, const Step *end, unsigned char *start, size_t base, size_t *done)
{
    for (; step < end; step += 1 + step->inner) {
        const size_t at = base + step->at;
        if (is_late(step)) {
            memset(start + *done, 0, at - *done);
            *done = at + step->size * step->most;
        } else if (step->what == MESSAGES && step->most == 0) {
            clear(step + 1, step + 1 + step->inner, start, at, done);
        }
    }
}

static bool put_float(const Step *step, unsigned char *into, PyObject *value)
{
    const double number = PyFloat_AsDouble(value);
    const float single = (float)number;
    memcpy(into, step->size == 8 ? (const void *)&number : &single, step->size);
    return (number != -1.0 || PyErr_Occurred() == NULL) && (step->size == 8 || !isinf(single) || isinf(number));
}

static bool put_bool(unsigned char *into, PyObject *value)
{
    const bool is_bool = value == Py_True || value == Py_False;
    const long number = is_bool || PyLong_CheckExact(value) ? PyLong_AsLong(value) : -1;
    *into = number == 1;
    return number == 0 || number == 1;
}

static bool put_whole(const Step *step, unsigned char *into, PyObject *value)
{
    const int bits = 8 * (int)step->size - (step->family == 'i');
    int overflow = 0;
    int64_t number;
    uint64_t large;
    if (step->code == 'Q') {
        large = PyLong_AsUnsignedLongLong(value);
        memcpy(into, &large, sizeof large);
        return large != UINT64_MAX || PyErr_Occurred() == NULL;
    }
    number = PyLong_AsLongLongAndOverflow(value, &overflow);
    memcpy(into, &number, step->size); /* the lower bytes: this machine is little-endian */
    return overflow == 0 && (bits == 63 || (number < INT64_C(1) << bits &&
                                            number >= (step->family == 'i' ? -(INT64_C(1) << bits) : 0)));
}

static bool put_number(const Step *step, unsigned char *into, PyObject *value)
{
    PyObject *whole;
    bool taken;
    if (step->family == 'f')
        return put_float(step, into, value);
    if (step->family == '?')
        return put_bool(into, value);
    if (PyLong_CheckExact(value))
        return put_whole(step, into, value);
    whole = PyNumber_Index(value);
    taken = whole != NULL && put_whole(step, into, whole);
    Py_XDECREF(whole);
    return taken;
}

/* At most `room` bytes of a longer text, that tear no character. */
static size_t cut(const char *data, size_t room, char code)
{
    if (code == 'u')
        while (room > 0 && ((unsigned char)data[room] & 0xC0) == 0x80)
            room--;
    else if (code == 'w' && room > 0 && ((unsigned char)data[room - 1] & 0xFC) == 0xD8)
        room -= 2;
    return room;
}

static bool put_text(Way *way, const Step *step, unsigned char *into, PyObject *value)
{
    const size_t room = step->size - (step->code == 'w' ? 2 : 1);
    PyObject *bytes = NULL;
    const char *data = NULL;
    Py_ssize_t length = 0;
    bool taken;
    if (!PyUnicode_CheckExact(value) || PyUnicode_FindChar(value, 0, 0, PyUnicode_GetLength(value), 1) != -1)
        return false; /* a NUL would end it */
    if (step->code == 'u') {
        data = PyUnicode_AsUTF8AndSize(value, &length);
    } else {
        bytes = PyUnicode_AsEncodedString(value, step->code == 'w' ? "utf-16-le" : "latin-1", NULL);
        data = bytes != NULL ? PyBytes_AsString(bytes) : NULL;
        length = bytes != NULL ? PyBytes_Size(bytes) : 0;
    }
    taken = data != NULL;
    if (taken && (size_t)length > room) {
        taken = step->cuts;
        length = (Py_ssize_t)cut(data, room, step->code);
        way->cuts++;
    }
    if (taken)
        memcpy(into, data, (size_t)length);
    Py_XDECREF(bytes);
    return taken;
}

static bool whole_of(PyObject *object, PyObject *name, int64_t *number)
{
    PyObject *value = PyObject_GetAttr(object, name);
    bool taken = value != NULL && PyLong_CheckExact(value);
    if (taken) {
        *number = PyLong_AsLongLong(value);
        taken = *number != -1 || PyErr_Occurred() == NULL;
    }
    Py_XDECREF(value);
    return taken;
}

/* False, without an exception: there is no such attribute. */
static bool has(PyObject *object, PyObject *name)
{
    PyObject *value = PyObject_GetAttr(object, name);
    Py_XDECREF(value);
    if (value == NULL && PyErr_ExceptionMatches(PyExc_AttributeError))
        PyErr_Clear();
    return value != NULL;
}

static bool put_clock(const Codec *self, char code, unsigned char *into, PyObject *value)
{
    int64_t seconds, nanos;
    uint64_t total;
    uint32_t words[2];
    if (!whole_of(value, self->tools[SEC], &seconds)) {
        if (PyErr_Occurred() == NULL || !PyErr_ExceptionMatches(PyExc_AttributeError))
            return false;
        PyErr_Clear();
        if (!whole_of(value, self->tools[SECS], &seconds) || !whole_of(value, self->tools[NSECS], &nanos))
            return false;
    } else if (!whole_of(value, self->tools[NANOSEC], &nanos)) {
        return false;
    }
    if (code == 'P') {
        words[0] = (uint32_t)seconds;
        words[1] = (uint32_t)nanos;
        memcpy(into, words, sizeof words);
        return seconds >= INT32_MIN && seconds <= INT32_MAX && nanos >= 0 && nanos <= UINT32_MAX;
    }
    if (seconds < 0 || nanos < 0 || __builtin_mul_overflow((uint64_t)seconds, (uint64_t)SECOND, &total) ||
        __builtin_add_overflow(total, (uint64_t)nanos, &total))
        return false;
    if (code == 'N') {
        memcpy(into, &total, sizeof total);
        return true;
    }
    words[0] = (uint32_t)(total / MILLISECOND);
    if (code == 'T' && words[0] == 0 && total != 0)
        words[0] = 1; /* zero would say that it is unset */
    memcpy(into, words, sizeof words[0]);
    return code == 'T' || total / MILLISECOND < (uint64_t)COME_ROUND;
}

static bool counted(const Step *step, unsigned char *message, Py_ssize_t length)
{
    const uint32_t count = (uint32_t)length;
    if (length < 0 || (size_t)length > step->most || (step->count_at < 0 && (size_t)length < step->most))
        return false;
    if (step->count_at >= 0)
        memcpy(message + step->count_at, &count, sizeof count);
    return true;
}

static bool are_such(const codec_buffer *view, const Step *step)
{
    const char *format = view->format != NULL ? view->format : "B";
    format += strspn(format, "@=<");
    return *format != 0 && format[1] == 0 && family(*format) == step->family && view->ndim > 0 &&
           view->itemsize == (Py_ssize_t)step->size;
}

/* The numbers of a buffer, now or late. */
static bool put_buffer(Way *way, const Step *step, unsigned char *message, PyObject *value)
{
    const bool late = is_late(step) && way->count < CODEC_MOST_LATE;
    unsigned char *into = message + step->at;
    codec_late *one = late ? &way->late[way->count] : NULL;
    codec_buffer here, *view = late ? &one->view : &here;
    bool taken;
    if (PyObject_GetBuffer(value, view, PyBUF_FULL_RO) != 0)
        return false;
    taken = are_such(view, step) && counted(step, message, view->len / view->itemsize);
    if (taken && late && PyBuffer_IsContiguous(view, 'C')) {
        one->offset = (size_t)(into - way->start);
        one->room = step->size * step->most;
        way->count++;
        return true;
    }
    taken = taken && PyBuffer_ToContiguous(into, view, view->len, 'C') == 0;
    if (taken && is_late(step))
        memset(into + view->len, 0, step->size * step->most - (size_t)view->len);
    PyBuffer_Release(view);
    return taken;
}

static bool put_one(Way *way, const Step *step, unsigned char *into, PyObject *value)
{
    switch (step->what) {
    case NUMBERS:
        return put_number(step, into, value);
    case TEXTS:
        return put_text(way, step, into, value);
    case CLOCKS:
        return put_clock(way->self, step->code, into, value);
    default:
        return put_all(way, step + 1, step + 1 + step->inner, into, value);
    }
}

/* The elements of anything that has a length and can be gone through, as they are now. */
static bool put_each(Way *way, const Step *step, unsigned char *message, PyObject *value)
{
    unsigned char *into = message + step->at;
    const Py_ssize_t length = PyObject_Size(value);
    PyObject *items = counted(step, message, length) ? PySequence_Tuple(value) : NULL;
    bool taken = items != NULL && PyTuple_Size(items) == length;
    for (Py_ssize_t index = 0; taken && index < length; index++, into += step->size)
        taken = put_one(way, step, into, PyTuple_GetItem(items, index));
    if (taken && is_late(step))
        memset(into, 0, (step->most - (size_t)length) * step->size);
    Py_XDECREF(items);
    return taken;
}

static bool put_array(Way *way, const Step *step, unsigned char *message, PyObject *value)
{
    if (step->what == TEXTS && (PyUnicode_Check(value) || PyBytes_Check(value)))
        return false;
    if (step->what == NUMBERS && !PyList_Check(value) && !PyTuple_Check(value))
        return put_buffer(way, step, message, value);
    return put_each(way, step, message, value);
}

static bool put_all(Way *way, const Step *step, const Step *end, unsigned char *into, PyObject *message)
{
    PyObject *dictionary = dictionary_of(way->self, message);
    bool taken = true;
    for (; taken && step < end; step += 1 + step->inner) {
        PyObject *value = get(message, dictionary, step->name);
        if (value == NULL)
            taken = false;
        else if (step->most != 0)
            taken = put_array(way, step, into, value);
        else
            taken = put_one(way, step, into + step->at, value);
        Py_XDECREF(value);
    }
    Py_XDECREF(dictionary);
    return taken;
}

/* What to answer: an Exception is not told, as Python meets it once more and says where. */
static int answer(bool done)
{
    if (done)
        return 0;
    if (PyErr_Occurred() != NULL) {
        if (!PyErr_ExceptionMatches(PyExc_Exception))
            return -1;
        PyErr_Clear();
    }
    return 1;
}

int codec_encode(PyObject *codec, PyObject *message, unsigned char *into, codec_late *late, size_t *count,
                 size_t *cuts)
{
    const Codec *self = (Codec *)codec;
    Way way = {self, into, late, 0, 0};
    size_t cleared = 0;
    int found;
    Py_INCREF(codec);
    Py_INCREF(message);
    if (self->has_late)
        clear(self->steps, self->steps + self->count, into, 0, &cleared);
    memset(into + cleared, 0, self->size - cleared);
    found = answer(put_all(&way, self->steps, self->steps + self->count, into, message));
    if (found != 0) {
        codec_release(late, way.count);
        way.count = way.cuts = 0;
        memset(into, 0, self->size);
    }
    Py_DECREF(message);
    Py_DECREF(codec);
    *count = way.count;
    *cuts = way.cuts;
    return found;
}

void codec_release(codec_late *late, size_t count)
{
    while (count > 0)
        PyBuffer_Release(&late[--count].view);
}

static PyObject *number_from(const Step *step, const unsigned char *from)
{
    const int unused = 64 - 8 * (int)step->size;
    uint64_t whole = 0;
    double number;
    float single;
    memcpy(&whole, from, step->size);
    switch (step->family) {
    case 'f':
        memcpy(&number, from, sizeof number * (step->size == 8));
        memcpy(&single, from, sizeof single);
        return PyFloat_FromDouble(step->size == 8 ? number : (double)single);
    case '?':
        return PyBool_FromLong((long)whole);
    case 'u':
        return PyLong_FromUnsignedLongLong(whole);
    default:
        return PyLong_FromLongLong((int64_t)(whole << unused) >> unused);
    }
}

static PyObject *text_from(const Step *step, const unsigned char *from)
{
    const char *text = (const char *)from;
    int little = -1;
    size_t length = 0;
    PyObject *made;
    if (step->code == 'w') {
        while (length + 1 < step->size && (from[length] != 0 || from[length + 1] != 0))
            length += 2;
        return PyUnicode_DecodeUTF16(text, (Py_ssize_t)length, "replace", &little);
    }
    length = strnlen(text, step->size);
    made = step->code == 'u' ? PyUnicode_DecodeUTF8(text, (Py_ssize_t)length, "strict") : NULL;
    if (made != NULL || (PyErr_Occurred() != NULL && !PyErr_ExceptionMatches(PyExc_UnicodeDecodeError)))
        return made;
    PyErr_Clear();
    return PyUnicode_DecodeLatin1(text, (Py_ssize_t)length, "strict");
}

static void parts_from(const unsigned char *from, char code, int64_t *seconds, int64_t *nanos)
{
    struct timespec now;
    uint64_t whole;
    uint32_t words[2];
    int64_t ms;
    if (code == 'N') {
        memcpy(&whole, from, sizeof whole);
        *seconds = (int64_t)(whole / (uint64_t)SECOND);
        *nanos = (int64_t)(whole % (uint64_t)SECOND);
        return;
    }
    memcpy(words, from, code == 'P' ? sizeof words : sizeof words[0]);
    if (code == 'P') {
        *seconds = (int32_t)words[0];
        *nanos = words[1];
        return;
    }
    ms = words[0];
    if (code == 'T' && ms != 0) { /* the instant nearest to now */
        clock_gettime(CLOCK_REALTIME, &now);
        ms = (int64_t)now.tv_sec * 1000 + now.tv_nsec / MILLISECOND;
        ms += (int32_t)(words[0] - (uint32_t)ms);
    }
    *seconds = ms / 1000;
    *nanos = ms % 1000 * MILLISECOND;
}

static bool is_ours(const Codec *self, PyTypeObject *type)
{
    return PyType_IsSubtype(type, (PyTypeObject *)self->tools[TIME]) ||
           PyType_IsSubtype(type, (PyTypeObject *)self->tools[DURATION]);
}

/* `like` set in place, as itself; or, where it is one of ours or NULL, a new one of ours. */
static PyObject *clock_from(const Codec *self, const Step *step, const unsigned char *from, PyObject *like)
{
    PyObject *seconds, *nanos, *made = NULL;
    int64_t parts[2];
    parts_from(from, step->code, &parts[0], &parts[1]);
    seconds = PyLong_FromLongLong(parts[0]);
    nanos = PyLong_FromLongLong(parts[1]);
    if (seconds != NULL && nanos != NULL && (like == NULL || is_ours(self, Py_TYPE(like)))) {
        made = PyObject_CallFunctionObjArgs(step->kind, seconds, nanos, NULL);
    } else if (seconds != NULL && nanos != NULL) {
        const bool is_ros2 = has(like, self->tools[SEC]);
        if (PyErr_Occurred() == NULL && PyObject_SetAttr(like, self->tools[is_ros2 ? SEC : SECS], seconds) == 0 &&
            PyObject_SetAttr(like, self->tools[is_ros2 ? NANOSEC : NSECS], nanos) == 0) {
            Py_INCREF(like);
            made = like;
        }
    }
    Py_XDECREF(seconds);
    Py_XDECREF(nanos);
    return made;
}

/* A copy of `like`, an array of array.array or numpy, with other numbers. NULL, without an exception: it has not as
 * many of the kind, or not in this order. */
static PyObject *copy_from(const Codec *self, const Step *step, const unsigned char *from, Py_ssize_t bytes,
                           PyObject *like)
{
    PyObject *made = PyObject_CallMethodObjArgs(like, self->tools[COPY_METHOD], NULL);
    codec_buffer view;
    bool done = false;
    if (made != NULL && PyObject_GetBuffer(made, &view, PyBUF_OF_ARRAY) == 0) {
        done = are_such(&view, step) && view.len == bytes;
        if (done)
            memcpy(view.buf, from, (size_t)bytes);
        PyBuffer_Release(&view);
    }
    if (!done)
        Py_CLEAR(made);
    if (PyErr_Occurred() != NULL && PyErr_ExceptionMatches(PyExc_Exception))
        PyErr_Clear();
    return made;
}

/* What from_numbers() makes, and a copy of the array that the attribute is now once it is known to make such. */
static PyObject *array_from(const Codec *self, Step *step, const unsigned char *from, Py_ssize_t bytes, PyObject *like)
{
    PyTypeObject *kind = Py_TYPE(like), *former;
    PyObject *made = kind == step->known ? copy_from(self, step, from, bytes, like) : NULL, *data;
    if (made != NULL || PyErr_Occurred() != NULL)
        return made;
    data = PyBytes_FromStringAndSize((const char *)from, bytes);
    if (data != NULL)
        made = PyObject_CallFunctionObjArgs(self->tools[FROM_NUMBERS], data, step->code_text, like, NULL);
    Py_XDECREF(data);
    if (made != NULL && Py_TYPE(made) == kind && kind != step->known) {
        former = step->known;
        Py_INCREF(kind);
        step->known = kind;
        Py_XDECREF(former);
    }
    return made;
}

static PyObject *ours_from(const Codec *self, const Step *step, const unsigned char *from)
{
    PyObject *bytes = PyBytes_FromStringAndSize((const char *)from, (Py_ssize_t)step->size), *made = NULL;
    if (bytes != NULL)
        made = PyObject_CallMethodObjArgs(step->kind, self->tools[FROM_BUFFER_COPY], bytes, NULL);
    Py_XDECREF(bytes);
    return made;
}

/* An element of a list: of the kind of `first`, and of ours if that is NULL. */
static PyObject *element_from(const Codec *self, Step *step, const unsigned char *from, PyObject *first)
{
    PyObject *like = NULL, *made;
    if (step->what == NUMBERS)
        return number_from(step, from);
    if (step->what == TEXTS)
        return text_from(step, from);
    if (first != NULL)
        like = PyObject_CallFunctionObjArgs(self->tools[step->what == CLOCKS ? COPY : NEW_LIKE], first, NULL);
    if (first != NULL && like == NULL)
        return NULL;
    if (step->what == CLOCKS) {
        made = clock_from(self, step, from, like);
        Py_XDECREF(like);
        return made;
    }
    if (like == NULL)
        return ours_from(self, step, from);
    if (!take_all(self, step + 1, step + 1 + step->inner, from, like))
        Py_CLEAR(like);
    return like;
}

/* A list of what the list `like` holds. */
static PyObject *list_from(const Codec *self, Step *step, const unsigned char *from, Py_ssize_t count, PyObject *like)
{
    const Py_ssize_t length = step->what == CLOCKS || step->what == MESSAGES ? PyObject_Size(like) : 0;
    PyObject *first = length > 0 ? PySequence_GetItem(like, 0) : NULL, *made = NULL;
    if (length == 0 || first != NULL)
        made = PyList_New(0);
    if (first != NULL &&
        (step->what == CLOCKS ? is_ours(self, Py_TYPE(first)) : (PyObject *)Py_TYPE(first) == step->kind))
        Py_CLEAR(first);
    for (Py_ssize_t index = 0; made != NULL && index < count; index++, from += step->size) {
        PyObject *item = element_from(self, step, from, first);
        if (item == NULL || PyList_Append(made, item) != 0)
            Py_CLEAR(made);
        Py_XDECREF(item);
    }
    Py_XDECREF(first);
    return made;
}

/* As from_numbers(): in the kind of sequence that the attribute is now. */
static PyObject *numbers_from(const Codec *self, Step *step, const unsigned char *from, Py_ssize_t count,
                              PyObject *like)
{
    const Py_ssize_t bytes = count * (Py_ssize_t)step->size;
    PyObject *list, *made;
    if (PyList_CheckExact(like))
        return list_from(self, step, from, count, like);
    if (PyBytes_CheckExact(like))
        return PyBytes_FromStringAndSize((const char *)from, bytes);
    if (!PyTuple_CheckExact(like))
        return array_from(self, step, from, bytes, like);
    list = list_from(self, step, from, count, like);
    made = list != NULL ? PyList_AsTuple(list) : NULL;
    Py_XDECREF(list);
    return made;
}

/* An array's value. NULL, also without an exception: Python is to look. */
static PyObject *many_from(const Codec *self, Step *step, const unsigned char *message, PyObject *like)
{
    const unsigned char *from = message + step->at;
    uint32_t count = (uint32_t)step->most;
    if (step->count_at >= 0)
        memcpy(&count, message + step->count_at, sizeof count);
    if (count > step->most)
        return NULL;
    if (step->what == NUMBERS)
        return numbers_from(self, step, from, (Py_ssize_t)count, like);
    return list_from(self, step, from, (Py_ssize_t)count, like);
}

static bool take_one(const Codec *self, Step *step, const unsigned char *message, PyObject *owner, PyObject *dictionary)
{
    const bool fresh = step->what == TEXTS || (step->what == NUMBERS && step->most == 0);
    const unsigned char *from = message + step->at;
    PyObject *like = fresh ? NULL : get(owner, dictionary, step->name), *made = NULL;
    bool taken = false;
    if (step->most != 0 && (like != NULL || fresh))
        made = many_from(self, step, message, like);
    else if (fresh)
        made = element_from(self, step, from, NULL);
    else if (like != NULL && step->what == CLOCKS)
        made = clock_from(self, step, from, like);
    else
        taken = like != NULL && take_all(self, step + 1, step + 1 + step->inner, from, like);
    if (made != NULL)
        taken = set(owner, dictionary, step->name, made);
    Py_XDECREF(made);
    Py_XDECREF(like);
    return taken;
}

static bool take_all(const Codec *self, Step *step, const Step *end, const unsigned char *from, PyObject *message)
{
    PyObject *dictionary = dictionary_of(self, message);
    bool taken = true;
    for (; taken && step < end; step += 1 + step->inner)
        taken = take_one(self, step, from, message, dictionary);
    Py_XDECREF(dictionary);
    return taken;
}

int codec_decode(PyObject *codec, const unsigned char *data, PyObject *message)
{
    const Codec *self = (Codec *)codec;
    int found;
    Py_INCREF(codec);
    Py_INCREF(message);
    found = answer(take_all(self, self->steps, self->steps + self->count, data, message));
    Py_DECREF(message);
    Py_DECREF(codec);
    return found;
}

/* For tests: encode(message, into), the texts that were cut; None: not for C. */
static PyObject *encode(PyObject *object, PyObject *arguments)
{
    PyObject *message, *into;
    codec_late late[CODEC_MOST_LATE];
    codec_buffer view;
    size_t count, cuts;
    int found;
    if (!PyArg_ParseTuple(arguments, "OO", &message, &into) || PyObject_GetBuffer(into, &view, PyBUF_WRITABLE) != 0)
        return NULL;
    if ((size_t)view.len != ((Codec *)object)->size) {
        PyBuffer_Release(&view);
        return PyErr_Format(PyExc_ValueError, "as many bytes as the message has");
    }
    found = codec_encode(object, message, view.buf, late, &count, &cuts);
    for (size_t index = 0; index < count; index++) {
        unsigned char *to = (unsigned char *)view.buf + late[index].offset;
        memset(to, 0, late[index].room);
        memcpy(to, late[index].view.buf, (size_t)late[index].view.len);
    }
    codec_release(late, count);
    PyBuffer_Release(&view);
    if (found < 0)
        return NULL;
    if (found == 0)
        return PyLong_FromSize_t(cuts);
    Py_RETURN_NONE;
}

/* decode(data, message): whether it was for C. */
static PyObject *decode(PyObject *object, PyObject *arguments)
{
    PyObject *data, *message;
    codec_buffer view;
    int found;
    if (!PyArg_ParseTuple(arguments, "OO", &data, &message) || PyObject_GetBuffer(data, &view, PyBUF_SIMPLE) != 0)
        return NULL;
    if ((size_t)view.len == ((Codec *)object)->size)
        found = codec_decode(object, view.buf, message);
    else
        found = 1;
    PyBuffer_Release(&view);
    return found < 0 ? NULL : PyBool_FromLong(found == 0);
}

/* What a row of the plan says. */
static bool step_of(Step *step, PyObject *row)
{
    static const char *const codes[] = {"?bBhHiIqQfd", "ulw", "TDNP"};
    int cuts;
    if (!PyArg_ParseTuple(row, "UUnnnnnpO", &step->name, &step->code_text, &step->at, &step->size, &step->most,
                          &step->count_at, &step->inner, &cuts, &step->kind))
        return false;
    step->code = (char)PyUnicode_ReadChar(step->code_text, 0);
    step->family = family(step->code);
    step->cuts = cuts;
    while (step->what < MESSAGES && strchr(codes[step->what], step->code) == NULL)
        step->what++;
    return true;
}

/* Codec(plan, size of a message, tools). */
static PyObject *make(PyTypeObject *type, PyObject *arguments, PyObject *keywords)
{
    PyObject *plan, *held;
    Py_ssize_t size, count;
    Codec *self;
    (void)keywords;
    if (!PyArg_ParseTuple(arguments, "O!nO!", &PyTuple_Type, &plan, &size, &PyTuple_Type, &held))
        return NULL;
    self = (Codec *)((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0);
    if (self == NULL)
        return NULL;
    Py_INCREF(plan);
    Py_INCREF(held);
    self->plan = plan;
    self->held = held;
    self->size = (size_t)size;
    count = PyTuple_Size(plan);
    self->steps = PyMem_Calloc((size_t)count + 1, sizeof(Step));
    if (self->steps == NULL)
        PyErr_NoMemory();
    for (int index = 0; PyErr_Occurred() == NULL && index < TOOLS; index++)
        self->tools[index] = PyTuple_GetItem(held, index);
    while (PyErr_Occurred() == NULL && self->count < count) {
        Step *step = &self->steps[self->count];
        self->count += step_of(step, PyTuple_GetItem(plan, self->count));
        self->has_late = self->has_late || is_late(step);
    }
    if (PyErr_Occurred() == NULL)
        return (PyObject *)self;
    Py_DECREF(self);
    return NULL;
}

static void codec_free(PyObject *object)
{
    Codec *self = (Codec *)object;
    PyTypeObject *type = Py_TYPE(object);
    while (self->count-- > 0)
        Py_XDECREF(self->steps[self->count].known);
    PyMem_Free(self->steps);
    Py_XDECREF(self->plan);
    Py_XDECREF(self->held);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(object);
    Py_DECREF(type);
}

bool codec_is(PyObject *object)
{
    return PyType_GetSlot(Py_TYPE(object), Py_tp_dealloc) == (void *)codec_free;
}

static PyMethodDef methods[] = {
    {"encode", encode, METH_VARARGS, NULL},
    {"decode", decode, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot slots[] = {
    {Py_tp_new, (void *)make},
    {Py_tp_methods, methods},
    {Py_tp_dealloc, (void *)codec_free},
    {0, NULL},
};

static PyType_Spec specification = {"shmgen._core.Codec", (int)sizeof(Codec), 0, Py_TPFLAGS_DEFAULT, slots};

int codec_fill(PyObject *module)
{
    PyObject *type = PyType_FromSpec(&specification);
    if (type == NULL || PyModule_AddObject(module, "Codec", type) != 0) {
        Py_XDECREF(type);
        return -1;
    }
    return 0;
}
