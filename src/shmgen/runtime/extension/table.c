/* The table as a Python type, the shared conversions of strings and times, and errors. */
#include "table.h"

#include <string.h>
#include <time.h>

#define SECOND INT64_C(1000000000)
#define MILLISECOND INT64_C(1000000)
#define COME_ROUND (INT64_C(1) << 32) /* the range of TIME in ms */

static const struct {
    const char *name;
    int what;
    char code, family;
    size_t size; /* of one element in bytes; 0 = the size in the row */
} kinds[] = {
    {"bool", NUMBERS, '?', '?', 1},     {"int8", NUMBERS, 'b', 'i', 1},        {"uint8", NUMBERS, 'B', 'u', 1},
    {"int16", NUMBERS, 'h', 'i', 2},    {"uint16", NUMBERS, 'H', 'u', 2},      {"int32", NUMBERS, 'i', 'i', 4},
    {"uint32", NUMBERS, 'I', 'u', 4},   {"int64", NUMBERS, 'q', 'i', 8},       {"uint64", NUMBERS, 'Q', 'u', 8},
    {"float32", NUMBERS, 'f', 'f', 4},  {"float64", NUMBERS, 'd', 'f', 8},     {"utf-8", TEXTS, 'u', 0, 0},
    {"latin-1", TEXTS, 'l', 0, 0},      {"utf-16", TEXTS, 'w', 0, 0},          {"time ms", CLOCKS, 'T', 0, 4},
    {"duration ms", CLOCKS, 'D', 0, 4}, {"time ns", CLOCKS, 'N', 0, 8},        {"duration ns", CLOCKS, 'N', 0, 8},
    {"time s+ns", CLOCKS, 'P', 0, 8},   {"duration s+ns", CLOCKS, 'P', 0, 8},
};

/* --- errors -------------------------------------------------------------------------------------------------- */

bool clear_misfit(void)
{
    if (PyErr_Occurred() != NULL && !PyErr_ExceptionMatches(PyExc_Exception))
        return false;
    PyErr_Clear();
    return true;
}

bool refuse(const Table *self, const Step *step, Py_ssize_t index, const char *reason)
{
    Py_XDECREF(PyObject_CallFunction(self->tools[REFUSE], "Ons", step->row, index, reason));
    return false;
}

bool refuse_count(const Table *self, const Step *step, size_t count)
{
    Py_XDECREF(PyObject_CallFunction(self->tools[TOO_MANY], "On", step->row, (Py_ssize_t)count));
    return false;
}

bool add_path(const Table *self, const Step *step, Py_ssize_t index)
{
    PyObject *type, *value, *traceback;
    if (!PyErr_ExceptionMatches(self->tools[REJECTED]))
        return false;
    PyErr_Fetch(&type, &value, &traceback);
    PyErr_NormalizeException(&type, &value, &traceback);
    Py_XDECREF(PyObject_CallFunction(self->tools[NESTED], "OnO", step->row, index, value));
    Py_XDECREF(type);
    Py_XDECREF(value);
    Py_XDECREF(traceback);
    return false;
}

bool put_by_python(const Table *self, const Step *step, unsigned char *into, PyObject *value, Py_ssize_t index)
{
    PyObject *bytes;
    bool fits;
    if (!clear_misfit())
        return false;
    bytes = PyObject_CallFunction(self->tools[ELEMENT], "OOn", step->row, value, index);
    fits = bytes != NULL && PyBytes_Check(bytes) && (size_t)PyBytes_Size(bytes) == step->size;
    if (fits)
        memcpy(into, PyBytes_AsString(bytes), step->size);
    Py_XDECREF(bytes);
    return fits;
}

/* --- texts --------------------------------------------------------------------------------------------------- */

/* Return the size in bytes of a longer string when truncated to at most `room` bytes, without cutting a character. */
static size_t truncated(const char *data, size_t room, char code)
{
    if (code == 'u')
        while (room > 0 && ((unsigned char)data[room] & 0xC0) == 0x80)
            room--;
    else if (code == 'w' && room > 0 && ((unsigned char)data[room - 1] & 0xFC) == 0xD8)
        room -= 2;
    return room;
}

/* Write a string into zeroed bytes. Return false if the value is not a string that fits; an exception may be set. */
bool put_text(const Step *step, unsigned char *into, PyObject *value, size_t *cuts)
{
    const size_t room = step->size - (step->code == 'w' ? 2 : 1);
    PyObject *bytes = NULL;
    const char *data = NULL;
    Py_ssize_t length = 0;
    bool fits;
    if (!PyUnicode_Check(value) || PyUnicode_FindChar(value, 0, 0, PyUnicode_GetLength(value), 1) != -1)
        return false; /* a NUL would end the string */
    if (step->code == 'u') {
        data = PyUnicode_AsUTF8AndSize(value, &length);
    } else {
        bytes = PyUnicode_AsEncodedString(value, step->code == 'w' ? "utf-16-le" : "latin-1", NULL);
        data = bytes != NULL ? PyBytes_AsString(bytes) : NULL;
        length = bytes != NULL ? PyBytes_Size(bytes) : 0;
    }
    fits = data != NULL;
    if (fits && (size_t)length > room) {
        fits = step->truncates;
        length = (Py_ssize_t)truncated(data, room, step->code);
        *cuts += 1;
    }
    if (fits)
        memcpy(into, data, (size_t)length);
    Py_XDECREF(bytes);
    return fits;
}

PyObject *text_from(const Step *step, const unsigned char *from)
{
    const char *text = (const char *)from;
    int little = -1;
    size_t length = 0;
    PyObject *result;
    if (step->code == 'w') {
        while (length + 1 < step->size && (from[length] != 0 || from[length + 1] != 0))
            length += 2;
        return PyUnicode_DecodeUTF16(text, (Py_ssize_t)length, "replace", &little);
    }
    length = strnlen(text, step->size);
    result = step->code == 'u' ? PyUnicode_DecodeUTF8(text, (Py_ssize_t)length, "strict") : NULL;
    if (result != NULL || (PyErr_Occurred() != NULL && !PyErr_ExceptionMatches(PyExc_UnicodeDecodeError)))
        return result;
    PyErr_Clear();
    return PyUnicode_DecodeLatin1(text, (Py_ssize_t)length, "strict");
}

/* --- times --------------------------------------------------------------------------------------------------- */

/* Write a time. Return false if its type cannot represent the value. */
bool put_parts(const Step *step, unsigned char *into, int64_t seconds, int64_t nanos)
{
    const char code = step->code;
    uint64_t total;
    uint32_t words[2];
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
        words[0] = 1; /* zero would mean an unset time */
    memcpy(into, words, sizeof words[0]);
    return code == 'T' || total / MILLISECOND < (uint64_t)COME_ROUND;
}

void parts_from(const Step *step, const unsigned char *from, int64_t *seconds, int64_t *nanos)
{
    const char code = step->code;
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
    if (code == 'T' && ms != 0) { /* choose the instant nearest to now */
        clock_gettime(CLOCK_REALTIME, &now);
        ms = (int64_t)now.tv_sec * 1000 + now.tv_nsec / MILLISECOND;
        ms += (int32_t)(words[0] - (uint32_t)ms);
    }
    *seconds = ms / 1000;
    *nanos = ms % 1000 * MILLISECOND;
}

/* --- the table ----------------------------------------------------------------------------------------------- */

/* Set the kind of a step by the name in its row. */
static bool set_kind(Step *step)
{
    static const char suffix[] = " truncated";
    Py_ssize_t length;
    const char *text = PyUnicode_AsUTF8AndSize(step->kind, &length);
    if (text == NULL)
        return false;
    step->is_duration = strncmp(text, "duration", 8) == 0;
    if (length > (Py_ssize_t)strlen(suffix) && strcmp(text + length - strlen(suffix), suffix) == 0) {
        length -= (Py_ssize_t)strlen(suffix);
        step->truncates = true;
    }
    for (size_t index = 0; index < sizeof kinds / sizeof kinds[0]; index++)
        if (strlen(kinds[index].name) == (size_t)length && strncmp(kinds[index].name, text, (size_t)length) == 0) {
            step->what = kinds[index].what;
            step->code = kinds[index].code;
            step->family = kinds[index].family;
            if (kinds[index].size != 0 ? step->size == kinds[index].size : step->size >= 2 || step->code != 'w')
                return true;
        }
    return PyErr_Format(PyExc_ValueError, "a table has a field of kind %R", step->kind) != NULL;
}

static bool fits_in(const Step *step, size_t size)
{
    return step->size != 0 && step->at <= size && element_count(step) <= (size - step->at) / step->size &&
           (step->count_at < 0 || (size_t)step->count_at + 4 <= size);
}

/* Set `unit` of a step. The steps of a nested message are complete. */
static void set_unit(Step *step)
{
    const Step *first = step + 1;
    if (step->count_at >= 0)
        return;
    if (step->what == NUMBERS && step->code != '?')
        step->unit = step->size;
    else if (step->what == MESSAGES && step->inner != 0 && first->at == 0 && first->run * first->unit == step->size)
        step->unit = first->unit;
}

/* Set `run` and `run_end` of the steps of one message. */
static void join_numbers(Step *first, const Step *end)
{
    for (Step *step = first; step < end; step += 1 + step->inner) {
        size_t stop = step->at;
        for (const Step *next = step; next < end && step->unit != 0 && next->unit == step->unit && next->at == stop;
             next += 1 + next->inner) {
            stop += next->size * element_count(next);
            step->run_end = next - step;
        }
        step->run = step->unit != 0 ? (stop - step->at) / step->unit : 0;
    }
}

/* Append the steps of a class. The steps of a nested message follow its own step. */
static bool add_steps(Table *self, PyObject *kind, size_t size)
{
    PyObject *rows = PyObject_GetAttrString(kind, "_steps_");
    bool fits = rows != NULL && PyTuple_Check(rows) && PyList_Append(self->references, rows) == 0;
    const Py_ssize_t count = fits ? PyTuple_Size(rows) : 0, first = self->count;
    for (Py_ssize_t index = 0; fits && index < count; index++) {
        const Py_ssize_t place = self->count;
        Step *steps = PyMem_Realloc(self->steps, (size_t)(place + 1) * sizeof *steps), *step;
        if (steps == NULL)
            PyErr_NoMemory();
        fits = steps != NULL;
        if (!fits)
            break;
        self->steps = steps;
        step = &steps[place];
        memset(step, 0, sizeof *step);
        self->count++;
        step->row = PyTuple_GetItem(rows, index);
        step->what = MESSAGES;
        fits = PyTuple_Check(step->row) && PyArg_ParseTuple(step->row, "UOnnnn", &step->name, &step->kind, &step->at,
                                                            &step->size, &step->length, &step->count_at);
        fits = fits && (!PyUnicode_Check(step->kind) || set_kind(step));
        if (fits && !fits_in(step, size))
            fits = PyErr_Format(PyExc_ValueError, "the field %R lies outside of its message", step->name) != NULL;
        if (fits && step->what == MESSAGES) {
            fits = add_steps(self, step->kind, step->size);
            self->steps[place].inner = self->count - place - 1;
        } else if (fits) {
            self->has_deferred = self->has_deferred || is_deferred(step);
        }
        set_unit(&self->steps[place]);
    }
    if (fits)
        join_numbers(self->steps + first, self->steps + self->count);
    Py_XDECREF(rows);
    if (!fits && PyErr_Occurred() == NULL)
        PyErr_SetString(PyExc_TypeError, "a table is a tuple of steps");
    return fits;
}

/* Table(class, size of its structure in bytes, tools): create a table. */
static PyObject *table_new(PyTypeObject *type, PyObject *arguments, PyObject *Py_UNUSED(keywords))
{
    PyObject *kind, *tools;
    Py_ssize_t size;
    Table *self;
    if (!PyArg_ParseTuple(arguments, "OnO!", &kind, &size, &PyTuple_Type, &tools))
        return NULL;
    self = (Table *)((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0);
    if (self == NULL)
        return NULL;
    self->size = (size_t)size;
    self->references = PyList_New(0);
    if (self->references != NULL && PyList_Append(self->references, tools) == 0)
        for (int index = 0; PyErr_Occurred() == NULL && index < TOOLS; index++)
            self->tools[index] = PyTuple_GetItem(tools, index);
    if (PyErr_Occurred() == NULL && add_steps(self, kind, self->size)) {
        self->wire_most = wire_most(self->steps, self->steps + self->count);
        return (PyObject *)self;
    }
    Py_DECREF(self);
    return NULL;
}

static void table_free(PyObject *object)
{
    Table *self = (Table *)object;
    PyTypeObject *type = Py_TYPE(object);
    while (self->count-- > 0)
        Py_XDECREF(self->steps[self->count].known);
    PyMem_Free(self->steps);
    Py_XDECREF(self->references);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(object);
    Py_DECREF(type);
}

static PyMethodDef methods[] = {
    {"to_wire", (PyCFunction)(void (*)(void))table_to_wire, METH_FASTCALL, NULL},
    {"from_wire", (PyCFunction)(void (*)(void))table_from_wire, METH_FASTCALL, NULL},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot slots[] = {
    {Py_tp_new, (void *)table_new},
    {Py_tp_methods, methods},
    {Py_tp_dealloc, (void *)table_free},
    {0, NULL},
};

PyType_Spec table_type = {"shmgen._core.Table", (int)sizeof(Table), 0, Py_TPFLAGS_DEFAULT, slots};
