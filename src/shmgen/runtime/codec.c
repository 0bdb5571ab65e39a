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
#define PyBUF_FULL_RO 0x11C
#endif

#define SECOND INT64_C(1000000000)
#define MILLISECOND INT64_C(1000000)
#define COME_ROUND (INT64_C(1) << 32) /* of TIME, in ms */

enum { NUMBERS, TEXTS, CLOCKS, MESSAGES }; /* WHAT of messages/plan.py */

/* One attribute of a message, or of an element of a list of such. The steps of a nested message follow its own. */
typedef struct Step {
    PyObject *name;
    PyObject *code_text; /* as array.array and numpy take it */
    PyObject *kind;      /* of a time or a nested message: our class; else None */
    size_t at;           /* offset in the message that it is an attribute of */
    size_t size;         /* of one element */
    size_t most;         /* elements; 0: no array */
    Py_ssize_t count_at; /* offset of the count of an array with a bound; -1: none */
    Py_ssize_t inner;    /* steps of a nested message */
    int what;
    char code;
    bool cuts; /* a text that is too long */
} Step;

enum { SEC, NANOSEC, SECS, NSECS, SIZE, SHAPE, TYPECODE, FROM_BUFFER_COPY, NUMPY, WORDS };
static const char *const WORD[WORDS] = {"sec",   "nanosec",  "secs",             "nsecs", "size",
                                        "shape", "typecode", "from_buffer_copy", "numpy"};

enum { ARRAY, COPY, NEW_LIKE, TIME, DURATION, TOOLS };

typedef struct Codec {
    PyObject_HEAD
    Step *steps;
    Py_ssize_t count;
    size_t size;
    PyObject *words[WORDS];
    PyObject *tools[TOOLS];
    PyObject *ndarray, *empty; /* of numpy, once there was an array of it */
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
static bool take_all(Codec *self, const Step *step, const Step *end, const unsigned char *from, PyObject *message);

static size_t size_of(char code)
{
    return strchr("qQd", code) != NULL ? 8 : strchr("iIf", code) != NULL ? 4 : strchr("hH", code) != NULL ? 2 : 1;
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

static bool put_float(unsigned char *into, char code, PyObject *value)
{
    const double number = PyFloat_AsDouble(value);
    const float single = (float)number;
    if (number == -1.0 && PyErr_Occurred() != NULL)
        return false;
    if (code == 'd') {
        memcpy(into, &number, sizeof number);
        return true;
    }
    memcpy(into, &single, sizeof single);
    return !isinf(single) || isinf(number);
}

static bool put_bool(unsigned char *into, PyObject *value)
{
    const long number = PyLong_CheckExact(value) ? PyLong_AsLong(value) : value == Py_True ? 1 : value == Py_False ? 0 : 2;
    *into = number == 1;
    return number == 0 || number == 1;
}

static bool put_whole(unsigned char *into, char code, PyObject *value)
{
    const size_t size = size_of(code);
    int overflow = 0;
    int64_t number;
    uint64_t large;
    if (code == 'Q') {
        large = PyLong_AsUnsignedLongLong(value);
        memcpy(into, &large, sizeof large);
        return large != UINT64_MAX || PyErr_Occurred() == NULL;
    }
    number = PyLong_AsLongLongAndOverflow(value, &overflow);
    if (overflow != 0)
        return false;
    memcpy(into, &number, size); /* the lower bytes: this machine is little-endian */
    if (size == 8)
        return true;
    if (family(code) == 'u')
        return number >= 0 && number >> (8 * size) == 0;
    return number >= -(INT64_C(1) << (8 * size - 1)) && number < INT64_C(1) << (8 * size - 1);
}

static bool put_number(unsigned char *into, char code, PyObject *value)
{
    PyObject *whole;
    bool taken;
    if (code == 'd' || code == 'f')
        return put_float(into, code, value);
    if (code == '?')
        return put_bool(into, value);
    if (PyLong_CheckExact(value))
        return put_whole(into, code, value);
    whole = PyNumber_Index(value);
    taken = whole != NULL && put_whole(into, code, whole);
    Py_XDECREF(whole);
    return taken;
}

static bool holds_nul(const char *data, size_t length, size_t unit)
{
    if (unit == 1)
        return memchr(data, 0, length) != NULL;
    for (size_t at = 0; at < length; at += 2)
        if (data[at] == 0 && data[at + 1] == 0)
            return true;
    return false;
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
    const size_t unit = step->code == 'w' ? 2 : 1, room = step->size - unit;
    PyObject *bytes = NULL;
    const char *data = NULL;
    Py_ssize_t length = 0;
    bool taken;
    if (!PyUnicode_CheckExact(value))
        return false;
    if (step->code == 'u') {
        data = PyUnicode_AsUTF8AndSize(value, &length);
    } else {
        bytes = step->code == 'w' ? PyUnicode_AsEncodedString(value, "utf-16-le", NULL) : PyUnicode_AsLatin1String(value);
        if (bytes != NULL) {
            data = PyBytes_AsString(bytes);
            length = PyBytes_Size(bytes);
        }
    }
    taken = data != NULL && !holds_nul(data, (size_t)length, unit);
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
    if (!whole_of(value, self->words[SEC], &seconds)) {
        if (PyErr_Occurred() == NULL || !PyErr_ExceptionMatches(PyExc_AttributeError))
            return false;
        PyErr_Clear();
        if (!whole_of(value, self->words[SECS], &seconds) || !whole_of(value, self->words[NSECS], &nanos))
            return false;
    } else if (!whole_of(value, self->words[NANOSEC], &nanos)) {
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
    return *format != 0 && format[1] == 0 && family(*format) == family(step->code) && view->ndim > 0 &&
           view->itemsize == (Py_ssize_t)step->size;
}

/* The numbers of a list or a tuple; what it is changed to meanwhile does not matter. */
static bool put_items(const Step *step, unsigned char *message, PyObject *value)
{
    PyObject *items = PySequence_Tuple(value);
    const Py_ssize_t length = items != NULL ? PyTuple_Size(items) : -1;
    bool taken = counted(step, message, length);
    unsigned char *into = message + step->at;
    for (Py_ssize_t index = 0; taken && index < length; index++, into += step->size)
        taken = put_number(into, step->code, PyTuple_GetItem(items, index));
    if (taken && is_late(step))
        memset(into, 0, (step->most - (size_t)length) * step->size);
    Py_XDECREF(items);
    return taken;
}

/* Those of a buffer, now or late. */
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
        return put_number(into, step->code, value);
    case TEXTS:
        return put_text(way, step, into, value);
    case CLOCKS:
        return put_clock(way->self, step->code, into, value);
    default:
        return put_all(way, step + 1, step + 1 + step->inner, into, value);
    }
}

/* Texts, times or messages, of anything that has a length and can be gone through. */
static bool put_each(Way *way, const Step *step, unsigned char *message, PyObject *value)
{
    unsigned char *into = message + step->at;
    PyObject *items;
    Py_ssize_t length;
    bool taken;
    if (step->what == TEXTS && (PyUnicode_Check(value) || PyBytes_Check(value)))
        return false;
    length = PyObject_Size(value);
    if (!counted(step, message, length))
        return false;
    items = PySequence_Tuple(value);
    taken = items != NULL && PyTuple_Size(items) == length;
    for (Py_ssize_t index = 0; taken && index < length; index++, into += step->size)
        taken = put_one(way, step, into, PyTuple_GetItem(items, index));
    Py_XDECREF(items);
    return taken;
}

static bool put_array(Way *way, const Step *step, unsigned char *message, PyObject *value)
{
    if (step->what != NUMBERS)
        return put_each(way, step, message, value);
    if (PyList_Check(value) || PyTuple_Check(value))
        return put_items(step, message, value);
    return put_buffer(way, step, message, value);
}

static bool put_all(Way *way, const Step *step, const Step *end, unsigned char *into, PyObject *message)
{
    for (; step < end; step += 1 + step->inner) {
        PyObject *value = PyObject_GetAttr(message, step->name);
        const bool taken = value != NULL && (step->most != 0 ? put_array(way, step, into, value)
                                                             : put_one(way, step, into + step->at, value));
        Py_XDECREF(value);
        if (!taken)
            return false;
    }
    return true;
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

int codec_encode(PyObject *codec, PyObject *message, unsigned char *into, codec_late *late, size_t *count, size_t *cuts)
{
    const Codec *self = (Codec *)codec;
    Way way = {self, into, late, 0, 0};
    size_t cleared = 0;
    int found;
    Py_INCREF(codec);
    Py_INCREF(message);
    clear(self->steps, self->steps + self->count, into, 0, &cleared);
    memset(into + cleared, 0, self->size - cleared);
    found = answer(put_all(&way, self->steps, self->steps + self->count, into, message));
    Py_DECREF(message);
    Py_DECREF(codec);
    if (found != 0) {
        codec_release(late, way.count);
        way.count = way.cuts = 0;
    }
    *count = way.count;
    *cuts = way.cuts;
    return found;
}

/* Also while an exception is set: letting go may run code. */
void codec_release(codec_late *late, size_t count)
{
    PyObject *type, *value, *traceback;
    if (count == 0)
        return;
    PyErr_Fetch(&type, &value, &traceback);
    while (count > 0)
        PyBuffer_Release(&late[--count].view);
    PyErr_Restore(type, value, traceback);
}

static PyObject *number_from(const unsigned char *from, char code)
{
    const size_t size = size_of(code);
    uint64_t large = 0;
    double number;
    float single;
    switch (code) {
    case 'd':
        memcpy(&number, from, sizeof number);
        return PyFloat_FromDouble(number);
    case 'f':
        memcpy(&single, from, sizeof single);
        return PyFloat_FromDouble((double)single);
    case '?':
        return PyBool_FromLong(*from);
    default:
        memcpy(&large, from, size);
        if (family(code) == 'u')
            return PyLong_FromUnsignedLongLong(large);
        large <<= 64 - 8 * size;
        return PyLong_FromLongLong((int64_t)large >> (64 - 8 * size));
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

/* As tuple.__new__(Time, (seconds, nanos)). */
static PyObject *new_clock(PyObject *kind, PyObject *seconds, PyObject *nanos)
{
    PyObject *values = PyTuple_Pack(2, seconds, nanos), *arguments = values != NULL ? PyTuple_Pack(1, values) : NULL;
    PyObject *made = NULL;
    if (arguments != NULL)
        made = ((newfunc)PyType_GetSlot(&PyTuple_Type, Py_tp_new))((PyTypeObject *)kind, arguments, NULL);
    Py_XDECREF(arguments);
    Py_XDECREF(values);
    return made;
}

/* `like` set in place, as itself; or, where it is one of ours or NULL, a new one of ours. */
static PyObject *clock_from(const Codec *self, const Step *step, const unsigned char *from, PyObject *like)
{
    PyTypeObject *type = like != NULL ? Py_TYPE(like) : NULL;
    PyObject *seconds, *nanos, *made = NULL;
    int64_t parts[2];
    parts_from(from, step->code, &parts[0], &parts[1]);
    seconds = PyLong_FromLongLong(parts[0]);
    nanos = PyLong_FromLongLong(parts[1]);
    if (seconds == NULL || nanos == NULL) {
    } else if (type == NULL || PyType_IsSubtype(type, (PyTypeObject *)self->tools[TIME]) ||
               PyType_IsSubtype(type, (PyTypeObject *)self->tools[DURATION])) {
        made = new_clock(step->kind, seconds, nanos);
    } else {
        const bool is_ros2 = has(like, self->words[SEC]);
        if (PyErr_Occurred() == NULL && PyObject_SetAttr(like, self->words[is_ros2 ? SEC : SECS], seconds) == 0 &&
            PyObject_SetAttr(like, self->words[is_ros2 ? NANOSEC : NSECS], nanos) == 0) {
            Py_INCREF(like);
            made = like;
        }
    }
    Py_XDECREF(seconds);
    Py_XDECREF(nanos);
    return made;
}

static PyObject *list_from(const Step *step, const unsigned char *from, Py_ssize_t count, bool is_tuple)
{
    PyObject *made = is_tuple ? PyTuple_New(count) : PyList_New(count);
    for (Py_ssize_t index = 0; made != NULL && index < count; index++, from += step->size) {
        PyObject *item = number_from(from, step->code);
        if (item == NULL)
            Py_CLEAR(made);
        else if (is_tuple)
            PyTuple_SetItem(made, index, item);
        else
            PyList_SetItem(made, index, item);
    }
    return made;
}

/* numpy has not been looked for before there was something that may be of it. */
static bool is_ndarray(Codec *self, PyObject *like)
{
    PyObject *numpy;
    if (self->ndarray == NULL && (PyObject *)Py_TYPE(like) != self->tools[ARRAY] && like != Py_None) {
        numpy = PyImport_GetModule(self->words[NUMPY]);
        if (numpy != NULL) {
            self->ndarray = PyObject_GetAttrString(numpy, "ndarray");
            self->empty = PyObject_GetAttrString(numpy, "empty");
            Py_DECREF(numpy);
        }
    }
    return self->ndarray != NULL && self->empty != NULL &&
           PyType_IsSubtype(Py_TYPE(like), (PyTypeObject *)self->ndarray);
}

/* Of the shape of `like` where it has as many elements. */
static PyObject *ndarray_from(Codec *self, const Step *step, const unsigned char *from, Py_ssize_t count, PyObject *like)
{
    PyObject *size = PyObject_GetAttr(like, self->words[SIZE]), *shape = NULL, *made = NULL;
    const Py_ssize_t bytes = count * (Py_ssize_t)step->size, found = size != NULL ? PyLong_AsSsize_t(size) : -1;
    codec_buffer view;
    if (found >= 0)
        shape = found == count ? PyObject_GetAttr(like, self->words[SHAPE]) : PyLong_FromSsize_t(count);
    if (shape != NULL)
        made = PyObject_CallFunctionObjArgs(self->empty, shape, step->code_text, NULL);
    Py_XDECREF(shape);
    Py_XDECREF(size);
    if (made == NULL || PyObject_GetBuffer(made, &view, PyBUF_WRITABLE) != 0) {
        Py_CLEAR(made);
        return NULL;
    }
    if (view.len == bytes)
        memcpy(view.buf, from, (size_t)bytes);
    else
        Py_CLEAR(made);
    PyBuffer_Release(&view);
    return made;
}

static PyObject *array_from(Codec *self, const Step *step, const unsigned char *from, Py_ssize_t bytes, PyObject *like)
{
    PyObject *data = PyBytes_FromStringAndSize((const char *)from, bytes), *made = NULL, *code = NULL;
    if ((PyObject *)Py_TYPE(like) == self->tools[ARRAY]) { /* one of `l` stays one of `l` */
        const char *text = (code = PyObject_GetAttr(like, self->words[TYPECODE])) != NULL
                               ? PyUnicode_AsUTF8AndSize(code, NULL)
                               : NULL;
        const size_t size = text == NULL ? 0 : strchr("lL", *text) != NULL ? sizeof(long) : size_of(*text);
        if (text != NULL && (family(*text) != family(step->code) || size != step->size))
            Py_CLEAR(code);
    }
    if (data != NULL && PyErr_Occurred() == NULL)
        made = PyObject_CallFunctionObjArgs(self->tools[ARRAY], code != NULL ? code : step->code_text, data, NULL);
    Py_XDECREF(code);
    Py_XDECREF(data);
    return made;
}

/* As from_numbers(): in the kind of sequence that the attribute is now. */
static PyObject *numbers_from(Codec *self, const Step *step, const unsigned char *from, Py_ssize_t count, PyObject *like)
{
    const Py_ssize_t bytes = count * (Py_ssize_t)step->size;
    if (PyBytes_CheckExact(like))
        return PyBytes_FromStringAndSize((const char *)from, bytes);
    if (PyByteArray_CheckExact(like))
        return PyByteArray_FromStringAndSize((const char *)from, bytes);
    if (PyList_CheckExact(like) || PyTuple_CheckExact(like))
        return list_from(step, from, count, PyTuple_CheckExact(like));
    if (is_ndarray(self, like))
        return ndarray_from(self, step, from, count, like);
    if (PyErr_Occurred() != NULL)
        return NULL;
    return step->code == '?' ? list_from(step, from, count, false) : array_from(self, step, from, bytes, like);
}

/* An element of a list, of the kind of the `first` of those that the attribute holds now. */
static PyObject *element_from(Codec *self, const Step *step, const unsigned char *from, PyObject *first)
{
    PyObject *type = first != NULL ? (PyObject *)Py_TYPE(first) : NULL, *bytes, *made;
    if (step->what == TEXTS)
        return text_from(step, from);
    if (step->what == CLOCKS) {
        if (type == NULL || type == self->tools[TIME] || type == self->tools[DURATION])
            return clock_from(self, step, from, NULL);
        first = PyObject_CallFunctionObjArgs(self->tools[COPY], first, NULL);
        made = first != NULL ? clock_from(self, step, from, first) : NULL;
        Py_XDECREF(first);
        return made;
    }
    if (type == NULL || type == step->kind) {
        bytes = PyBytes_FromStringAndSize((const char *)from, (Py_ssize_t)step->size);
        made = bytes != NULL ? PyObject_CallMethodObjArgs(step->kind, self->words[FROM_BUFFER_COPY], bytes, NULL) : NULL;
        Py_XDECREF(bytes);
        return made;
    }
    made = PyObject_CallFunctionObjArgs(self->tools[NEW_LIKE], first, NULL);
    if (made != NULL && !take_all(self, step + 1, step + 1 + step->inner, from, made))
        Py_CLEAR(made);
    return made;
}

static PyObject *elements_from(Codec *self, const Step *step, const unsigned char *from, Py_ssize_t count, PyObject *like)
{
    const Py_ssize_t length = step->what != TEXTS ? PyObject_Size(like) : 0;
    PyObject *first = length > 0 ? PySequence_GetItem(like, 0) : NULL, *made = NULL;
    if (length == 0 || first != NULL)
        made = PyList_New(0);
    for (Py_ssize_t index = 0; made != NULL && index < count; index++, from += step->size) {
        PyObject *item = element_from(self, step, from, first);
        if (item == NULL || PyList_Append(made, item) != 0)
            Py_CLEAR(made);
        Py_XDECREF(item);
    }
    Py_XDECREF(first);
    return made;
}

/* Of an array. NULL, also without an exception: Python is to look. */
static PyObject *many_from(Codec *self, const Step *step, const unsigned char *message, PyObject *like)
{
    uint32_t count = (uint32_t)step->most;
    if (step->count_at >= 0)
        memcpy(&count, message + step->count_at, sizeof count);
    if (count > step->most || like == NULL)
        return NULL;
    return (step->what == NUMBERS ? numbers_from : elements_from)(self, step, message + step->at, (Py_ssize_t)count, like);
}

/* One attribute. */
static bool take_one(Codec *self, const Step *step, const unsigned char *message, PyObject *owner)
{
    const unsigned char *from = message + step->at;
    const bool fresh = step->what == TEXTS || (step->what == NUMBERS && step->most == 0);
    PyObject *like = fresh ? Py_None : PyObject_GetAttr(owner, step->name), *made = NULL;
    bool taken = false;
    if (step->most != 0)
        made = many_from(self, step, message, like);
    else if (step->what == NUMBERS)
        made = number_from(from, step->code);
    else if (step->what == TEXTS)
        made = text_from(step, from);
    else if (step->what == CLOCKS)
        made = like != NULL ? clock_from(self, step, from, like) : NULL;
    else
        taken = like != NULL && take_all(self, step + 1, step + 1 + step->inner, from, like);
    if (made != NULL)
        taken = PyObject_SetAttr(owner, step->name, made) == 0;
    Py_XDECREF(made);
    if (!fresh)
        Py_XDECREF(like);
    return taken;
}

static bool take_all(Codec *self, const Step *step, const Step *end, const unsigned char *from, PyObject *message)
{
    for (; step < end; step += 1 + step->inner)
        if (!take_one(self, step, from, message))
            return false;
    return true;
}

int codec_decode(PyObject *codec, const unsigned char *data, PyObject *message)
{
    Codec *self = (Codec *)codec;
    int found;
    Py_INCREF(codec);
    Py_INCREF(message);
    found = answer(take_all(self, self->steps, self->steps + self->count, data, message));
    Py_DECREF(message);
    Py_DECREF(codec);
    return found;
}

size_t codec_size(PyObject *codec)
{
    return ((Codec *)codec)->size;
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
    if ((size_t)view.len != codec_size(object)) {
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
    if ((size_t)view.len == codec_size(object))
        found = codec_decode(object, view.buf, message);
    else
        found = 1;
    PyBuffer_Release(&view);
    return found < 0 ? NULL : PyBool_FromLong(found == 0);
}

/* Whether all that the steps write is within a message of so many bytes. */
static bool are_within(const Step *step, const Step *end, size_t size)
{
    for (; step < end; step += 1 + step->inner) {
        const size_t many = step->most != 0 ? step->most : 1;
        const size_t least = step->what == NUMBERS  ? size_of(step->code)
                             : step->what == TEXTS  ? 1 + (size_t)(step->code == 'w')
                             : step->what == CLOCKS ? 4 + 4 * (size_t)(step->code == 'N' || step->code == 'P')
                                                    : 1;
        if (step->inner < 0 || step->inner >= end - step || step->size < least || step->at > size ||
            many > (size - step->at) / step->size || step->count_at > (Py_ssize_t)size - 4)
            return false;
        if (step->what == NUMBERS && step->size != least)
            return false;
        if (step->what == MESSAGES && !are_within(step + 1, step + 1 + step->inner, step->size))
            return false;
    }
    return true;
}

/* What a row of the plan says, each object owned. */
static bool step_of(Step *step, PyObject *row)
{
    static const char *const codes[] = {"?bBhHiIqQfd", "ulw", "TDNP", "M"};
    PyObject *name, *code_text, *kind;
    int cuts;
    if (!PyArg_ParseTuple(row, "UUnnnnnpO", &name, &code_text, &step->at, &step->size, &step->most, &step->count_at,
                          &step->inner, &cuts, &kind))
        return false;
    Py_INCREF(name);
    Py_INCREF(code_text);
    Py_INCREF(kind);
    PyUnicode_InternInPlace(&name);
    step->name = name;
    step->code_text = code_text;
    step->kind = kind;
    step->code = (char)PyUnicode_ReadChar(code_text, 0);
    step->cuts = cuts;
    while (step->what < MESSAGES && strchr(codes[step->what], step->code) == NULL)
        step->what++;
    return PyErr_Occurred() == NULL && (step->what < CLOCKS || PyType_Check(kind));
}

/* Codec(plan, size of a message, (array.array, copy.copy, arrays.new_like, Time, Duration)). */
static PyObject *make(PyTypeObject *type, PyObject *arguments, PyObject *keywords)
{
    PyObject *plan, *tools[TOOLS];
    Py_ssize_t size, count;
    Codec *self;
    bool made = true;
    (void)keywords;
    if (!PyArg_ParseTuple(arguments, "O!n(OOOO!O!)", &PyTuple_Type, &plan, &size, &tools[ARRAY], &tools[COPY],
                          &tools[NEW_LIKE], &PyType_Type, &tools[TIME], &PyType_Type, &tools[DURATION]))
        return NULL;
    self = (Codec *)((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0);
    if (self == NULL)
        return NULL;
    for (int index = 0; index < TOOLS; index++) {
        Py_INCREF(tools[index]);
        self->tools[index] = tools[index];
    }
    for (int index = 0; made && index < WORDS; index++)
        made = (self->words[index] = PyUnicode_InternFromString(WORD[index])) != NULL;
    count = PyTuple_Size(plan);
    self->size = (size_t)size;
    self->steps = PyMem_Calloc((size_t)count + 1, sizeof(Step));
    made = made && self->steps != NULL && size >= 0;
    for (; made && self->count < count; self->count++)
        made = step_of(&self->steps[self->count], PyTuple_GetItem(plan, self->count));
    if (made && are_within(self->steps, self->steps + count, self->size))
        return (PyObject *)self;
    Py_DECREF(self);
    return PyErr_Occurred() != NULL ? NULL : PyErr_Format(PyExc_ValueError, "this is no plan");
}

static void codec_free(PyObject *object)
{
    Codec *self = (Codec *)object;
    PyTypeObject *type = Py_TYPE(object);
    while (self->count-- > 0) {
        Py_XDECREF(self->steps[self->count].name);
        Py_XDECREF(self->steps[self->count].code_text);
        Py_XDECREF(self->steps[self->count].kind);
    }
    PyMem_Free(self->steps);
    for (int index = 0; index < WORDS; index++)
        Py_XDECREF(self->words[index]);
    for (int index = 0; index < TOOLS; index++)
        Py_XDECREF(self->tools[index]);
    Py_XDECREF(self->ndarray);
    Py_XDECREF(self->empty);
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
