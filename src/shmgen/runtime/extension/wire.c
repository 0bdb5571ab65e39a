/* Convert messages to and from the serialization of ROS: XCDR1 of OMG's DDS-XTypes in either byte order, or ROS 1. No
 * serialized data can cause an access outside of the structure or of the data. */
#include "table.h"

#include <string.h>

/* The state of one call. `room` is the size of `bytes`. */
typedef struct Wire {
    const Table *self;
    unsigned char *payload, *bytes; /* `bytes` starts after the head */
    size_t at, room;
    bool writes; /* true: the call copies from `payload` to `bytes`; false: from `bytes` to `payload` */
    bool swaps;  /* true if the numbers in `bytes` that are read are big-endian */
    bool is_ros1;
    Py_ssize_t stamp_at; /* offset of the stamp; -1 = none */
    PyObject *now;       /* function that returns seconds and nanoseconds for a zero stamp */
} Wire;

static bool convert_fields(Wire *wire, const Step *step, const Step *end, unsigned char *message);

/* --- bytes --------------------------------------------------------------------------------------------------- */

/* Skip the padding before a number. When writing, set the padding to zero. */
static inline bool align(Wire *wire, size_t size)
{
    const size_t pad = wire->is_ros1 ? 0 : (size - wire->at % size) % size;
    if (pad > wire->room - wire->at)
        return false;
    if (wire->writes)
        memset(wire->bytes + wire->at, 0, pad);
    wire->at += pad;
    return true;
}

/* Return true if the data contains these numbers and any padding before them. */
static bool has_numbers(const Wire *wire, size_t size, size_t count)
{
    return size * (count + 1) <= wire->room - wire->at;
}

static void copy_swapped(unsigned char *into, const unsigned char *from, size_t size, size_t count)
{
    for (; count > 0; count--, into += size, from += size)
        for (size_t index = 0; index < size; index++)
            into[index] = from[size - 1 - index];
}

/* Copy `count` numbers of `size` bytes from `memory` to the serialized bytes or, when reading, back. */
static inline bool copy(Wire *wire, void *memory, size_t size, size_t count)
{
    unsigned char *bytes = wire->bytes + wire->at;
    if (size * count > wire->room - wire->at)
        return false;
    wire->at += size * count;
    if (wire->swaps)
        copy_swapped(memory, bytes, size, count);
    else
        memcpy(wire->writes ? bytes : memory, wire->writes ? memory : bytes, size * count);
    return true;
}

static bool copy_u32(Wire *wire, void *number)
{
    return align(wire, sizeof(uint32_t)) && copy(wire, number, sizeof(uint32_t), 1);
}

static bool refuse_end(const Wire *wire, const Step *step, Py_ssize_t index)
{
    return refuse(wire->self, step, index, "the bytes end within this field");
}

static bool is_ascii(const unsigned char *text, size_t length)
{
    for (size_t index = 0; index < length; index++)
        if (text[index] == 0 || text[index] > 127)
            return false;
    return true;
}

/* --- to ROS -------------------------------------------------------------------------------------------------- */

/* Set the parts of an unset stamp to the time that `now` returns. */
static bool fill_stamp(const Wire *wire, int64_t parts[2])
{
    PyObject *time = PyObject_CallObject(wire->now, NULL);
    long long seconds, nanos;
    const bool is_complete = time != NULL && PyArg_ParseTuple(time, "LL", &seconds, &nanos);
    if (is_complete) {
        parts[0] = seconds;
        parts[1] = nanos;
    }
    Py_XDECREF(time);
    return is_complete;
}

static bool put_time(Wire *wire, const Step *step, const unsigned char *from, Py_ssize_t index)
{
    const bool is_ros1 = wire->is_ros1, is_signed = !is_ros1 || step->is_duration;
    const int64_t most_nanos = is_ros1 && step->is_duration ? INT32_MAX : UINT32_MAX;
    int64_t parts[2];
    uint32_t words[2];
    parts_from(step, from, &parts[0], &parts[1]);
    if (from - wire->payload == wire->stamp_at && parts[0] == 0 && parts[1] == 0 && !fill_stamp(wire, parts))
        return false;
    if (parts[0] < (is_signed ? INT32_MIN : 0) || parts[0] > (is_signed ? INT32_MAX : UINT32_MAX) || parts[1] < 0 ||
        parts[1] > most_nanos)
        return refuse(wire->self, step, index, "ROS cannot represent this time");
    words[0] = (uint32_t)parts[0];
    words[1] = (uint32_t)parts[1];
    return align(wire, 4) && copy(wire, words, 4, 2);
}

static bool put_string(Wire *wire, const Step *step, const unsigned char *from)
{
    const size_t ends = !wire->is_ros1;
    size_t length = strnlen((const char *)from, step->size);
    PyObject *text = NULL;
    const char *data = (const char *)from;
    uint32_t size;
    bool is_complete;
    if (!is_ascii(from, length)) {
        Py_ssize_t bytes = 0;
        text = text_from(step, from);
        data = text != NULL ? PyUnicode_AsUTF8AndSize(text, &bytes) : NULL;
        length = (size_t)bytes;
    }
    size = (uint32_t)(length + ends);
    is_complete = data != NULL && copy_u32(wire, &size) && copy(wire, (void *)data, 1, length) && copy(wire, "", 1, ends);
    Py_XDECREF(text);
    return is_complete;
}

/* Write a wide string with four bytes per unit, as in rosidl's code for Fast DDS. */
static bool put_wide_string(Wire *wire, const Step *step, const unsigned char *from)
{
    PyObject *text = text_from(step, from);
    PyObject *units = text != NULL ? PyUnicode_AsEncodedString(text, "utf-16-le", NULL) : NULL;
    const unsigned char *data = units != NULL ? (const unsigned char *)PyBytes_AsString(units) : NULL;
    uint32_t length = units != NULL ? (uint32_t)PyBytes_Size(units) / 2 : 0;
    bool is_complete = data != NULL && copy_u32(wire, &length);
    for (uint32_t index = 0; is_complete && index < length; index++) {
        uint32_t unit = (uint32_t)data[2 * index] | (uint32_t)data[2 * index + 1] << 8;
        is_complete = copy(wire, &unit, sizeof unit, 1);
    }
    Py_XDECREF(text);
    Py_XDECREF(units);
    return is_complete;
}

/* --- from ROS ------------------------------------------------------------------------------------------------ */

static bool take_time(Wire *wire, const Step *step, unsigned char *into, Py_ssize_t index)
{
    const bool is_ros1 = wire->is_ros1;
    uint32_t words[2];
    int64_t seconds, nanos;
    PyObject *time;
    bool fits;
    if (!align(wire, 4) || !copy(wire, words, 4, 2))
        return refuse_end(wire, step, index);
    seconds = is_ros1 && !step->is_duration ? (int64_t)words[0] : (int64_t)(int32_t)words[0];
    nanos = is_ros1 && step->is_duration ? (int64_t)(int32_t)words[1] : (int64_t)words[1];
    if (put_parts(step, into, seconds, nanos))
        return true;
    time = PyObject_CallFunction(wire->self->tools[TIME], "LL", (long long)seconds, (long long)nanos);
    fits = time != NULL && put_by_python(wire->self, step, into, time, index);
    Py_XDECREF(time);
    return fits;
}

static bool put_decoded(Wire *wire, const Step *step, unsigned char *into, PyObject *text, Py_ssize_t index)
{
    size_t cuts = 0;
    bool fits;
    if (text == NULL) {
        if (!PyErr_ExceptionMatches(PyExc_UnicodeDecodeError))
            return false;
        PyErr_Clear();
        return refuse(wire->self, step, index, "the bytes are not valid text");
    }
    fits = put_text(step, into, text, &cuts) || put_by_python(wire->self, step, into, text, index);
    Py_DECREF(text);
    return fits;
}

static bool take_wide_string(Wire *wire, const Step *step, unsigned char *into, Py_ssize_t index)
{
    uint32_t length, unit = 0;
    unsigned char *units;
    int little = -1;
    bool is_complete = true;
    PyObject *text;
    if (!copy_u32(wire, &length) || length > (wire->room - wire->at) / 4)
        return refuse_end(wire, step, index);
    units = PyMem_Malloc(2 * (size_t)length + 1);
    if (units == NULL)
        return PyErr_NoMemory() != NULL;
    for (size_t place = 0; is_complete && place < length; place++) {
        is_complete = copy(wire, &unit, sizeof unit, 1) && unit <= UINT16_MAX;
        units[2 * place] = (unsigned char)unit;
        units[2 * place + 1] = (unsigned char)(unit >> 8);
    }
    if (is_complete) {
        text = PyUnicode_DecodeUTF16((char *)units, (Py_ssize_t)(2 * (size_t)length), "strict", &little);
        is_complete = put_decoded(wire, step, into, text, index);
    } else {
        refuse(wire->self, step, index, "the bytes are not valid text");
    }
    PyMem_Free(units);
    return is_complete;
}

static bool take_string(Wire *wire, const Step *step, unsigned char *into, Py_ssize_t index)
{
    const size_t ends = !wire->is_ros1;
    const unsigned char *text;
    uint32_t length;
    if (!copy_u32(wire, &length) || length > wire->room - wire->at)
        return refuse_end(wire, step, index);
    text = wire->bytes + wire->at;
    if (length < ends || (ends && text[length - 1] != 0))
        return refuse(wire->self, step, index, "the text does not end in NUL");
    wire->at += length;
    length -= (uint32_t)ends;
    if (length < step->size && step->code != 'w' && is_ascii(text, length)) {
        memcpy(into, text, length);
        return true;
    }
    return put_decoded(wire, step, into, PyUnicode_DecodeUTF8((const char *)text, length, "strict"), index);
}

/* --- in both directions -------------------------------------------------------------------------------------- */

static bool convert_numbers(Wire *wire, const Step *step, unsigned char *memory, size_t count)
{
    if (count != 0 && !(align(wire, step->size) && copy(wire, memory, step->size, count)))
        return refuse_end(wire, step, -1);
    for (size_t index = 0; step->code == '?' && index < count; index++)
        if (wire->writes) /* a PLC may have written any byte */
            wire->bytes[wire->at - count + index] = memory[index] != 0;
        else if (memory[index] > 1)
            return refuse(wire->self, step, step->length != 0 ? (Py_ssize_t)index : -1, "the byte is not a bool");
    return true;
}

static bool convert_element(Wire *wire, const Step *step, unsigned char *memory, Py_ssize_t index)
{
    if (step->what == MESSAGES)
        return convert_fields(wire, step + 1, step + 1 + step->inner, memory) ||
               (PyErr_Occurred() != NULL && add_path(wire->self, step, index));
    if (step->what == CLOCKS)
        return wire->writes ? put_time(wire, step, memory, index) : take_time(wire, step, memory, index);
    if (step->code == 'w')
        return wire->writes ? put_wide_string(wire, step, memory) : take_wide_string(wire, step, memory, index);
    return wire->writes ? put_string(wire, step, memory) : take_string(wire, step, memory, index);
}

static bool convert_fields(Wire *wire, const Step *step, const Step *end, unsigned char *message)
{
    unsigned char filler = 0;
    if (step == end) /* a message without fields */
        return wire->is_ros1 || copy(wire, &filler, 1, 1);
    for (; step < end; step += 1 + step->inner) {
        unsigned char *memory = message + step->at;
        uint32_t count = (uint32_t)element_count(step);
        if (step->count_at >= 0) {
            if (!copy_u32(wire, message + step->count_at))
                return refuse_end(wire, step, -1);
            memcpy(&count, message + step->count_at, sizeof count);
            if (count > step->length)
                return refuse_count(wire->self, step, count);
        } else if (step->run != 0 && has_numbers(wire, step->unit, step->run)) {
            align(wire, step->unit);
            copy(wire, memory, step->unit, step->run);
            step += step->run_end;
            continue;
        }
        if (step->what == NUMBERS && !convert_numbers(wire, step, memory, count))
            return false;
        for (uint32_t index = 0; step->what != NUMBERS && index < count; index++, memory += step->size)
            if (!convert_element(wire, step, memory, step->length != 0 ? (Py_ssize_t)index : -1))
                return false;
    }
    return true;
}

/* Return the maximum size in bytes of some steps in the serialization of ROS, including padding. */
size_t wire_most(const Step *step, const Step *end)
{
    size_t most = 1;
    for (; step < end; step += 1 + step->inner) {
        const size_t each = step->what == MESSAGES  ? wire_most(step + 1, step + 1 + step->inner)
                            : step->what == NUMBERS ? step->size
                                                    : 2 * step->size + 12; /* padding, length or two numbers, UTF-8 */
        most += 16 + element_count(step) * each;
    }
    return most;
}

static bool has_arguments(Py_ssize_t count, Py_ssize_t expected)
{
    return count == expected || PyErr_Format(PyExc_TypeError, "%zd arguments, expected %zd", count, expected) != NULL;
}

/* to_wire(payload, is ROS 1, offset of the stamp or -1, now): return the serialized message. `now()` returns seconds
 * and nanoseconds, which replace the stamp if it is zero. */
PyObject *table_to_wire(PyObject *object, PyObject *const *arguments, Py_ssize_t count)
{
    const Table *self = (Table *)object;
    Wire wire = {.self = self, .room = self->wire_most, .writes = true};
    codec_buffer view;
    PyObject *result = NULL;
    unsigned char *buffer = NULL;
    size_t head;
    if (!has_arguments(count, 4))
        return NULL;
    wire.is_ros1 = PyObject_IsTrue(arguments[1]) != 0;
    wire.stamp_at = PyLong_AsSsize_t(arguments[2]);
    wire.now = arguments[3];
    if (PyErr_Occurred() != NULL || PyObject_GetBuffer(arguments[0], &view, PyBUF_SIMPLE) != 0)
        return NULL;
    head = wire.is_ros1 ? 0 : 4;
    if ((size_t)view.len != self->size) {
        PyErr_SetString(PyExc_ValueError, "the bytes do not have the size of the message");
    } else if ((buffer = PyMem_Malloc(head + self->wire_most)) == NULL) {
        PyErr_NoMemory();
    } else {
        memcpy(buffer, "\0\1\0\0", head); /* little-endian */
        wire.payload = view.buf;
        wire.bytes = buffer + head;
        if (convert_fields(&wire, self->steps, self->steps + self->count, wire.payload))
            result = PyBytes_FromStringAndSize((char *)buffer, (Py_ssize_t)(head + wire.at));
    }
    PyMem_Free(buffer);
    PyBuffer_Release(&view);
    return result;
}

/* from_wire(data, is ROS 1): return the payload as a bytearray. */
PyObject *table_from_wire(PyObject *object, PyObject *const *arguments, Py_ssize_t count)
{
    const Table *self = (Table *)object;
    Wire wire = {.self = self};
    codec_buffer view;
    PyObject *result;
    bool is_complete;
    size_t head;
    if (!has_arguments(count, 2))
        return NULL;
    wire.is_ros1 = PyObject_IsTrue(arguments[1]) != 0;
    if (PyErr_Occurred() != NULL || PyObject_GetBuffer(arguments[0], &view, PyBUF_SIMPLE) != 0)
        return NULL;
    result = PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)self->size);
    head = wire.is_ros1 ? 0 : 4;
    is_complete = result != NULL && (size_t)view.len >= head;
    if (is_complete) {
        const unsigned char *bytes = view.buf;
        wire.bytes = (unsigned char *)view.buf + head;
        wire.room = (size_t)view.len - head;
        wire.payload = (unsigned char *)PyByteArray_AsString(result);
        wire.swaps = !wire.is_ros1 && bytes[1] == 0;
        memset(wire.payload, 0, self->size);
        is_complete = (wire.is_ros1 || (bytes[0] == 0 && bytes[1] <= 1)) &&
               convert_fields(&wire, self->steps, self->steps + self->count, wire.payload) &&
               wire.room - wire.at <= (wire.is_ros1 ? 0u : 3u);
    }
    PyBuffer_Release(&view);
    if (is_complete)
        return result;
    Py_XDECREF(result);
    if (PyErr_Occurred() == NULL)
        PyErr_SetString(PyExc_ValueError, "the bytes have another encoding or length than the message");
    return NULL;
}
