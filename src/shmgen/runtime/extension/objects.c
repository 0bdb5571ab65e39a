/* Convert messages to and from the attributes of any Python object.
 *
 * Attributes, numbers and buffers may run any code of the user. So this file has a strong reference to every object
 * that it uses across such a call. It uses the limited API of CPython: one binary works for 3.10 and later
 * versions. */
#include "table.h"

#include <math.h>
#include <string.h>

#define PyBUF_OF_ARRAY (PyBUF_WRITABLE | PyBUF_FORMAT | PyBUF_ND) /* in C order */

/* The state of one call of codec_encode(). */
typedef struct EncodeState {
    const Table *self;
    unsigned char *start;
    codec_deferred *deferred;
    size_t count;
    size_t cuts;
} EncodeState;

static bool encode_fields(EncodeState *state, const Step *step, const Step *end, unsigned char *into, PyObject *message);
static bool decode_fields(const Table *self, Step *step, const Step *end, const unsigned char *from, PyObject *message);

/* Return the dictionary of a SimpleNamespace, or NULL for any other object. The dictionary holds all attributes, and
 * reading the dictionary takes half the time of reading attributes. */
static PyObject *dictionary_of(const Table *self, PyObject *message)
{
    PyObject *result = NULL;
    if ((PyObject *)Py_TYPE(message) == self->tools[NAMESPACE] && (result = PyObject_GenericGetDict(message, NULL)) == NULL)
        PyErr_Clear();
    return result;
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

/* Set all bytes to zero, except the bytes of deferred arrays. */
static void clear(const Step *step, const Step *end, unsigned char *start, size_t base, size_t *done)
{
    for (; step < end; step += 1 + step->inner) {
        const size_t at = base + step->at;
        if (is_deferred(step)) {
            memset(start + *done, 0, at - *done);
            *done = at + step->size * step->length;
        } else if (step->what == MESSAGES && step->length == 0) {
            clear(step + 1, step + 1 + step->inner, start, at, done);
        }
    }
}

static char family(char code)
{
    if (strchr("bhilqn", code) != NULL)
        return 'i';
    if (strchr("BHILQNc", code) != NULL)
        return 'u';
    return strchr("fd", code) != NULL ? 'f' : code;
}

static bool put_float(const Step *step, unsigned char *into, PyObject *value)
{
    const double number = PyFloat_AsDouble(value);
    float single;
    if (number == -1.0 && PyErr_Occurred() != NULL)
        return false;
    if (step->size == sizeof number) {
        memcpy(into, &number, sizeof number);
        return true;
    }
    single = (float)number;
    memcpy(into, &single, sizeof single);
    return !isinf(single) || isinf(number);
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
    memcpy(into, &number, step->size); /* the lower bytes, because this machine is little-endian */
    return overflow == 0 && (bits == 63 || (number < INT64_C(1) << bits &&
                                            number >= (step->family == 'i' ? -(INT64_C(1) << bits) : 0)));
}

static bool put_number(const Step *step, unsigned char *into, PyObject *value)
{
    PyObject *whole;
    bool fits;
    if (step->family == 'f')
        return put_float(step, into, value);
    if (step->family == '?')
        return put_bool(into, value);
    if (PyLong_CheckExact(value))
        return put_whole(step, into, value);
    whole = PyNumber_Index(value);
    fits = whole != NULL && put_whole(step, into, whole);
    Py_XDECREF(whole);
    return fits;
}

/* Return an attribute as an integer. NULL without an exception means that there is no such attribute or integer. */
static PyObject *whole_attribute(PyObject *value, PyObject *name)
{
    PyObject *part = PyObject_GetAttr(value, name), *whole = part != NULL ? PyNumber_Index(part) : NULL;
    Py_XDECREF(part);
    if (whole == NULL && (PyErr_ExceptionMatches(PyExc_AttributeError) || PyErr_ExceptionMatches(PyExc_TypeError)))
        PyErr_Clear();
    return whole;
}

/* Read the two parts of a time from attributes of these names. Return false if a part is missing; an exception may be
 * set. */
static bool parts_of(PyObject *value, PyObject *seconds_name, PyObject *nanos_name, PyObject *parts[2])
{
    parts[0] = whole_attribute(value, seconds_name);
    parts[1] = parts[0] != NULL ? whole_attribute(value, nanos_name) : NULL;
    if (parts[1] == NULL)
        Py_CLEAR(parts[0]);
    return parts[1] != NULL;
}

/* Write a time of ROS 2 or ROS 1. If the time does not fit, walker.py raises the error. */
static bool put_clock(const Table *self, const Step *step, unsigned char *into, PyObject *value, Py_ssize_t index)
{
    PyObject *parts[2], *time;
    int over[2] = {0, 0};
    int64_t seconds, nanos;
    bool fits;
    if (!parts_of(value, self->tools[SEC], self->tools[NANOSEC], parts) &&
        (PyErr_Occurred() != NULL || !parts_of(value, self->tools[SECS], self->tools[NSECS], parts)))
        return PyErr_Occurred() == NULL && put_by_python(self, step, into, value, index);
    seconds = PyLong_AsLongLongAndOverflow(parts[0], &over[0]);
    nanos = PyLong_AsLongLongAndOverflow(parts[1], &over[1]);
    fits = over[0] == 0 && over[1] == 0 && put_parts(step, into, seconds, nanos);
    if (!fits && PyErr_Occurred() == NULL) {
        time = PyObject_CallFunctionObjArgs(self->tools[TIME], parts[0], parts[1], NULL);
        fits = time != NULL && put_by_python(self, step, into, time, index);
        Py_XDECREF(time);
    }
    Py_DECREF(parts[0]);
    Py_DECREF(parts[1]);
    return fits;
}

/* Write the count of an array. Return false if the array does not fit. */
static bool counted(const Step *step, unsigned char *message, Py_ssize_t length)
{
    const uint32_t count = (uint32_t)length;
    if (length < 0 || (size_t)length > step->length || (step->count_at < 0 && (size_t)length < step->length))
        return false;
    if (step->count_at >= 0)
        memcpy(message + step->count_at, &count, sizeof count);
    return true;
}

/* Return true if a buffer contains numbers of the type of the field. */
static bool buffer_matches(const codec_buffer *view, const Step *step)
{
    const char *format = view->format != NULL ? view->format : "B";
    format += strspn(format, "@=<");
    return *format != 0 && format[1] == 0 && family(*format) == step->family && view->ndim > 0 &&
           view->itemsize == (Py_ssize_t)step->size;
}

/* Write the numbers of the buffer `value`, or its raw bytes if `is_raw` is true: now, or later as a deferred array.
 * Return false if the type or the number of elements does not fit; an exception may be set. */
static bool put_buffer(EncodeState *state, const Step *step, unsigned char *message, PyObject *value, bool is_raw)
{
    const bool deferred = is_deferred(step) && state->count < CODEC_MOST_DEFERRED;
    unsigned char *into = message + step->at;
    codec_deferred *one = deferred ? &state->deferred[state->count] : NULL;
    codec_buffer here, *view = deferred ? &one->view : &here;
    bool fits;
    if (PyObject_GetBuffer(value, view, PyBUF_FULL_RO) != 0)
        return false;
    fits = (is_raw || buffer_matches(view, step)) && counted(step, message, view->len / (Py_ssize_t)step->size);
    if (fits && deferred && PyBuffer_IsContiguous(view, 'C')) {
        one->offset = (size_t)(into - state->start);
        one->room = step->size * step->length;
        state->count++;
        return true;
    }
    fits = fits && PyBuffer_ToContiguous(into, view, view->len, 'C') == 0;
    if (fits && is_deferred(step))
        memset(into + view->len, 0, step->size * step->length - (size_t)view->len);
    PyBuffer_Release(view);
    return fits;
}

static bool encode_element(EncodeState *state, const Step *step, unsigned char *into, PyObject *value, Py_ssize_t index)
{
    switch (step->what) {
    case NUMBERS:
        return put_number(step, into, value) || put_by_python(state->self, step, into, value, index);
    case TEXTS:
        return put_text(step, into, value, &state->cuts) || put_by_python(state->self, step, into, value, index);
    case CLOCKS:
        return put_clock(state->self, step, into, value, index);
    default:
        return encode_fields(state, step + 1, step + 1 + step->inner, into, value) || add_path(state->self, step, index);
    }
}

/* Return the elements of a sequence as a tuple, and write its count. A list or tuple is read here; walker.py reads any
 * other sequence. walker.py refuses other values, sequences that are too long, and sequences with a wrong len(). */
static PyObject *elements_of(const EncodeState *state, const Step *step, unsigned char *message, PyObject *value)
{
    const bool is_list = PyList_CheckExact(value);
    const Py_ssize_t length = is_list ? PyList_Size(value) : PyTuple_CheckExact(value) ? PyTuple_Size(value) : -1;
    PyObject *result, *items;
    if (length >= 0 && counted(step, message, length))
        return PySequence_Tuple(value);
    result = PyObject_CallFunctionObjArgs(state->self->tools[SEQUENCE], step->row, value, NULL);
    items = result != NULL ? PySequence_Tuple(result) : NULL;
    Py_XDECREF(result);
    if (items == NULL || counted(step, message, PyTuple_Size(items)))
        return items;
    refuse_count(state->self, step, (size_t)PyTuple_Size(items));
    Py_DECREF(items);
    return NULL;
}

static bool encode_each(EncodeState *state, const Step *step, unsigned char *message, PyObject *value)
{
    unsigned char *into = message + step->at;
    PyObject *items = elements_of(state, step, message, value);
    const Py_ssize_t length = items != NULL ? PyTuple_Size(items) : 0;
    bool fits = items != NULL;
    for (Py_ssize_t index = 0; fits && index < length; index++, into += step->size)
        fits = encode_element(state, step, into, PyTuple_GetItem(items, index), index);
    if (fits && is_deferred(step))
        memset(into, 0, (step->length - (size_t)length) * step->size);
    Py_XDECREF(items);
    return fits;
}

static bool encode_array(EncodeState *state, const Step *step, unsigned char *message, PyObject *value)
{
    PyObject *result;
    bool fits;
    if (step->what != NUMBERS || PyList_CheckExact(value) || PyTuple_CheckExact(value))
        return encode_each(state, step, message, value);
    if (put_buffer(state, step, message, value, false))
        return true;
    if (!clear_misfit())
        return false;
    result = PyObject_CallFunctionObjArgs(state->self->tools[NUMBER_ARRAY], step->row, value, NULL);
    fits = result != NULL && put_buffer(state, step, message, result, true);
    Py_XDECREF(result);
    return fits;
}

/* Set the error for a message without this field, or for an attribute that raises an error. */
static bool refuse_attribute(const Table *self, const Step *step, PyObject *message)
{
    PyObject *type, *value, *traceback;
    if (!PyErr_ExceptionMatches(PyExc_AttributeError))
        return false;
    PyErr_Fetch(&type, &value, &traceback);
    PyErr_NormalizeException(&type, &value, &traceback);
    Py_XDECREF(PyObject_CallFunctionObjArgs(self->tools[MISSING], message, step->name, value, NULL));
    Py_XDECREF(type);
    Py_XDECREF(value);
    Py_XDECREF(traceback);
    return false;
}

static bool encode_fields(EncodeState *state, const Step *step, const Step *end, unsigned char *into, PyObject *message)
{
    PyObject *dictionary = dictionary_of(state->self, message);
    bool fits = true;
    for (; fits && step < end; step += 1 + step->inner) {
        PyObject *value = get(message, dictionary, step->name);
        if (value == NULL)
            fits = refuse_attribute(state->self, step, message);
        else if (step->length != 0)
            fits = encode_array(state, step, into, value);
        else
            fits = encode_element(state, step, into + step->at, value, -1);
        Py_XDECREF(value);
    }
    Py_XDECREF(dictionary);
    return fits;
}

bool codec_encode(PyObject *table, PyObject *message, unsigned char *into, codec_deferred *deferred, size_t *count,
                  size_t *cuts)
{
    const Table *self = (Table *)table;
    EncodeState state = {self, into, deferred, 0, 0};
    size_t cleared = 0;
    bool fits;
    Py_INCREF(table);
    Py_INCREF(message);
    if (self->has_deferred)
        clear(self->steps, self->steps + self->count, into, 0, &cleared);
    memset(into + cleared, 0, self->size - cleared);
    fits = encode_fields(&state, self->steps, self->steps + self->count, into, message);
    if (!fits) {
        codec_release(deferred, state.count);
        state.count = state.cuts = 0;
        if (PyErr_Occurred() == NULL)
            PyErr_SetString(PyExc_SystemError, "a buffer or a table has changed while a message was encoded");
    }
    Py_DECREF(message);
    Py_DECREF(table);
    *count = state.count;
    *cuts = state.cuts;
    return fits;
}

void codec_release(codec_deferred *deferred, size_t count)
{
    while (count > 0)
        PyBuffer_Release(&deferred[--count].view);
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

/* Return true if the object has the attribute. A false result without an exception means that there is none. */
static bool has(PyObject *object, PyObject *name)
{
    PyObject *value = PyObject_GetAttr(object, name);
    Py_XDECREF(value);
    if (value == NULL && PyErr_ExceptionMatches(PyExc_AttributeError))
        PyErr_Clear();
    return value != NULL;
}

/* Return true for the Time and Duration of shmgen, which cannot change. */
static bool is_ours(const Table *self, PyTypeObject *type)
{
    return PyType_IsSubtype(type, (PyTypeObject *)self->tools[TIME]) ||
           PyType_IsSubtype(type, (PyTypeObject *)self->tools[DURATION]);
}

/* Set the time `like` in place and return `like`. If `like` is NULL or of an immutable type of shmgen, return a new
 * Time or Duration. */
static PyObject *clock_from(const Table *self, const Step *step, const unsigned char *from, PyObject *like)
{
    PyObject *seconds, *nanos, *result = NULL;
    int64_t parts[2];
    parts_from(step, from, &parts[0], &parts[1]);
    seconds = PyLong_FromLongLong(parts[0]);
    nanos = PyLong_FromLongLong(parts[1]);
    if (seconds != NULL && nanos != NULL && (like == NULL || is_ours(self, Py_TYPE(like)))) {
        result = PyObject_CallFunctionObjArgs(self->tools[step->is_duration ? DURATION : TIME], seconds, nanos, NULL);
    } else if (seconds != NULL && nanos != NULL) {
        const bool is_ros2 = has(like, self->tools[SEC]);
        if (PyErr_Occurred() == NULL && PyObject_SetAttr(like, self->tools[is_ros2 ? SEC : SECS], seconds) == 0 &&
            PyObject_SetAttr(like, self->tools[is_ros2 ? NANOSEC : NSECS], nanos) == 0) {
            Py_INCREF(like);
            result = like;
        }
    }
    Py_XDECREF(seconds);
    Py_XDECREF(nanos);
    return result;
}

/* Return a copy of `like`, an array of array.array or numpy, with other numbers. Return NULL without an exception
 * if the element type, the number of elements or their order differs. */
static PyObject *copy_from(const Table *self, const Step *step, const unsigned char *from, Py_ssize_t bytes,
                           PyObject *like)
{
    PyObject *result = PyObject_CallMethodObjArgs(like, self->tools[COPY_METHOD], NULL);
    codec_buffer view;
    bool done = false;
    if (result != NULL && PyObject_GetBuffer(result, &view, PyBUF_OF_ARRAY) == 0) {
        done = buffer_matches(&view, step) && view.len == bytes;
        if (done)
            memcpy(view.buf, from, (size_t)bytes);
        PyBuffer_Release(&view);
    }
    if (!done)
        Py_CLEAR(result);
    if (PyErr_Occurred() != NULL && PyErr_ExceptionMatches(PyExc_Exception))
        PyErr_Clear();
    return result;
}

/* Return the result of DECODE_NUMBERS. Once that function is known to return the type of `like`, return a copy of
 * `like` with the new numbers, which is faster. */
static PyObject *array_from(const Table *self, Step *step, const unsigned char *from, Py_ssize_t bytes, PyObject *like)
{
    PyTypeObject *kind = Py_TYPE(like), *former;
    PyObject *result = kind == step->known ? copy_from(self, step, from, bytes, like) : NULL, *data;
    if (result != NULL || PyErr_Occurred() != NULL)
        return result;
    data = PyBytes_FromStringAndSize((const char *)from, bytes);
    if (data != NULL)
        result = PyObject_CallFunctionObjArgs(self->tools[DECODE_NUMBERS], data, step->kind, like, NULL);
    Py_XDECREF(data);
    if (result != NULL && Py_TYPE(result) == kind && kind != step->known) {
        former = step->known;
        Py_INCREF(kind);
        step->known = kind;
        Py_XDECREF(former);
    }
    return result;
}

/* Return a nested message as an object of its generated class. */
static PyObject *ours_from(const Table *self, const Step *step, const unsigned char *from)
{
    PyObject *bytes = PyBytes_FromStringAndSize((const char *)from, (Py_ssize_t)step->size), *result = NULL;
    if (bytes != NULL)
        result = PyObject_CallMethodObjArgs(step->kind, self->tools[FROM_BUFFER_COPY], bytes, NULL);
    Py_XDECREF(bytes);
    return result;
}

/* Return an element of a list, with the type of `first`, or with a type of shmgen if `first` is NULL. */
static PyObject *element_from(const Table *self, Step *step, const unsigned char *from, PyObject *first,
                              Py_ssize_t index)
{
    PyObject *like = NULL, *result;
    if (step->what == NUMBERS)
        return number_from(step, from);
    if (step->what == TEXTS)
        return text_from(step, from);
    if (first != NULL)
        like = PyObject_CallFunctionObjArgs(self->tools[step->what == CLOCKS ? COPY : NEW_LIKE], first, NULL);
    if (first != NULL && like == NULL)
        return NULL;
    if (step->what == CLOCKS) {
        result = clock_from(self, step, from, like);
        Py_XDECREF(like);
        return result;
    }
    if (like == NULL)
        return ours_from(self, step, from);
    if (!decode_fields(self, step + 1, step + 1 + step->inner, from, like)) {
        add_path(self, step, index);
        Py_CLEAR(like);
    }
    return like;
}

/* Return the elements as a list, with the element type of the list `like`. */
static PyObject *list_from(const Table *self, Step *step, const unsigned char *from, Py_ssize_t count, PyObject *like)
{
    const Py_ssize_t length = step->what == CLOCKS || step->what == MESSAGES ? PyObject_Size(like) : 0;
    PyObject *first = length > 0 ? PySequence_GetItem(like, 0) : NULL, *result = NULL;
    if (length == 0 || first != NULL)
        result = PyList_New(0);
    if (first != NULL &&
        (step->what == CLOCKS ? is_ours(self, Py_TYPE(first)) : (PyObject *)Py_TYPE(first) == step->kind))
        Py_CLEAR(first);
    for (Py_ssize_t index = 0; result != NULL && index < count; index++, from += step->size) {
        PyObject *item = element_from(self, step, from, first, index);
        if (item == NULL || PyList_Append(result, item) != 0)
            Py_CLEAR(result);
        Py_XDECREF(item);
    }
    Py_XDECREF(first);
    return result;
}

/* Return the numbers in the present kind of sequence of the attribute, like DECODE_NUMBERS. */
static PyObject *numbers_from(const Table *self, Step *step, const unsigned char *from, Py_ssize_t count,
                              PyObject *like)
{
    const Py_ssize_t bytes = count * (Py_ssize_t)step->size;
    PyObject *list, *result;
    if (PyList_CheckExact(like))
        return list_from(self, step, from, count, like);
    if (PyBytes_CheckExact(like))
        return PyBytes_FromStringAndSize((const char *)from, bytes);
    if (PyByteArray_CheckExact(like))
        return PyByteArray_FromStringAndSize((const char *)from, bytes);
    if (!PyTuple_CheckExact(like))
        return array_from(self, step, from, bytes, like);
    list = list_from(self, step, from, count, like);
    result = list != NULL ? PyList_AsTuple(list) : NULL;
    Py_XDECREF(list);
    return result;
}

static PyObject *many_from(const Table *self, Step *step, const unsigned char *message, PyObject *like)
{
    const unsigned char *from = message + step->at;
    uint32_t count = (uint32_t)step->length;
    if (step->count_at >= 0)
        memcpy(&count, message + step->count_at, sizeof count);
    if (count > step->length) {
        refuse_count(self, step, count);
        return NULL;
    }
    if (step->what == NUMBERS)
        return numbers_from(self, step, from, (Py_ssize_t)count, like);
    return list_from(self, step, from, (Py_ssize_t)count, like);
}

static bool decode_field(const Table *self, Step *step, const unsigned char *message, PyObject *owner, PyObject *dictionary)
{
    const bool fresh = step->what == TEXTS || (step->what == NUMBERS && step->length == 0);
    const unsigned char *from = message + step->at;
    PyObject *like = fresh ? NULL : get(owner, dictionary, step->name), *result = NULL;
    bool fits = false;
    if (step->length != 0 && (like != NULL || fresh))
        result = many_from(self, step, message, like);
    else if (fresh)
        result = element_from(self, step, from, NULL, -1);
    else if (like != NULL && step->what == CLOCKS)
        result = clock_from(self, step, from, like);
    else if (like != NULL)
        fits = decode_fields(self, step + 1, step + 1 + step->inner, from, like) || add_path(self, step, -1);
    if (result != NULL)
        fits = set(owner, dictionary, step->name, result);
    Py_XDECREF(result);
    Py_XDECREF(like);
    return fits;
}

static bool decode_fields(const Table *self, Step *step, const Step *end, const unsigned char *from, PyObject *message)
{
    PyObject *dictionary = dictionary_of(self, message);
    bool fits = true;
    for (; fits && step < end; step += 1 + step->inner)
        fits = decode_field(self, step, from, message, dictionary);
    Py_XDECREF(dictionary);
    return fits;
}

bool codec_decode(PyObject *table, const unsigned char *data, PyObject *message)
{
    const Table *self = (Table *)table;
    bool fits;
    Py_INCREF(table);
    Py_INCREF(message);
    fits = decode_fields(self, self->steps, self->steps + self->count, data, message);
    Py_DECREF(message);
    Py_DECREF(table);
    return fits;
}
