/* The engine for Python: the C headers of templates/c as two types, Writer and Reader, and one sleep on many readers.
 *
 * Nothing of the protocol is decided here. A call that has to wait gives the interpreter's lock away, and no Python code
 * runs between taking the region's lock and giving it back: so a signal handler, a property or another thread that
 * publishes on the same publisher finds it as between two calls. In CPython's limited API: one binary for 3.10 and all
 * later. runtime/reference/ says the same in Python.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <structmember.h>

#include "shmgen_runtime.h"

#include "codec.h"

#if defined(Py_LIMITED_API) && Py_LIMITED_API + 0 < 0x030B0000
PyAPI_FUNC(int) PyObject_GetBuffer(PyObject *object, codec_buffer *view, int flags);
PyAPI_FUNC(void) PyBuffer_Release(codec_buffer *view);
#define PyBUF_SIMPLE 0
#define PyBUF_WRITABLE 1
#endif

#define LONG_FROM 4096 /* bytes of a message that is copied into a bytearray, and lies in it */

static PyObject *explainer; /* makes an error of (settings, status, pid, errno) */

/* What an end is opened with: a tuple of Python's, in which all else lies. */
typedef struct Settings {
    PyObject *tuple, *kind, *codec;
    newfunc make; /* a message without its defaults */
    const char *topic, *type_name, *group;
    unsigned long long digest;
    unsigned int size, depth, mode, pid, spin_us;
    long long lock_ns; /* -1: as is usual */
    int sequence, passive, history;
} Settings;

/* --- threads ------------------------------------------------------------------------------------------------ */

/* Who is in a call that has given the interpreter's lock away. */
typedef struct Turn {
    unsigned int sleepers; /* look at words of the region only, and may be many */
    bool taken;            /* by the one that changes something */
} Turn;

/* Waits for another thread's call to end, and for sleepers if they count. False: a signal handler raised meanwhile. */
static bool await_turn(const Turn *turn, bool sleepers)
{
    while (turn->taken || (sleepers && turn->sleepers != 0)) {
        Py_BEGIN_ALLOW_THREADS
        shmgen_pause(SHMGEN_MS / 10);
        Py_END_ALLOW_THREADS
        if (PyErr_CheckSignals() != 0)
            return false;
    }
    return true;
}

static bool take_turn(Turn *turn)
{
    if (!await_turn(turn, false))
        return false;
    turn->taken = true;
    return true;
}

/* --- what both ends have ------------------------------------------------------------------------------------ */

/* A Writer or a Reader. A call takes its room and its scratch along, so that one that comes upon it has its own. */
typedef struct End {
    PyObject_HEAD
    PyObject *weak;
    Settings of;
    Turn turn;
    unsigned char *room; /* for one message, outside of Python */
    bool writes;
    union {
        shmgen_link link; /* both begin with it */
        shmgen_publisher p;
        shmgen_subscriber s;
    };
    unsigned long long truncations;
    PyObject *scratch; /* a bytearray for messages that Python encodes */
    PyObject *nothing; /* () to make a message without its defaults */
    PyObject *lies_in; /* for long ones: kind.from_buffer */
} End;

static shmgen_status *gone(End *self)
{
    return self->writes ? &self->p.gone : &self->s.gone;
}

/* Raises what Python says of that status. */
static PyObject *refused(const End *self, shmgen_status status)
{
    const int number = errno;
    PyObject *error =
        PyObject_CallFunction(explainer, "OiIi", self->of.tuple, (int)status, self->of.pid, number);
    if (error != NULL)
        PyErr_SetObject((PyObject *)Py_TYPE(error), error);
    Py_XDECREF(error);
    return NULL;
}

static PyObject *done(const End *self, shmgen_status status)
{
    if (status != SHMGEN_OK)
        return refused(self, status);
    Py_RETURN_NONE;
}

/* False, and an exception: it is not open. */
static bool is_open(End *self)
{
    return self->link.step == SHMGEN_STEP_READY || refused(self, shmgen_why(*gone(self))) != NULL;
}

/* Takes the settings over; the strings are valid as long as the tuple is kept. */
static bool settle(Settings *of, PyObject *arguments)
{
    const char *word;
    PyObject *tuple, *header;
    if (of->tuple != NULL)
        return PyErr_Format(PyExc_RuntimeError, "begun already") != NULL;
    if (!PyArg_ParseTuple(arguments, "O!", &PyTuple_Type, &tuple) ||
        !PyArg_ParseTuple(tuple, "sOOsKIILIspppIsO", &of->topic, &of->kind, &of->codec, &of->type_name, &of->digest,
                          &of->size, &of->depth, &of->lock_ns, &of->mode, &of->group, &of->sequence, &of->passive,
                          &of->history, &of->spin_us, &word, &header))
        return false;
    of->make = (newfunc)PyType_GetSlot((PyTypeObject *)of->kind, Py_tp_new);
    of->pid = (unsigned int)getpid();
    of->tuple = tuple;
    Py_INCREF(tuple);
    return true;
}

/* Begins to open it; what `start` is given is valid for that call. */
static int begin_end(PyObject *object, PyObject *arguments, bool writes)
{
    End *self = (End *)object;
    Settings *of = &self->of;
    shmgen_type type;
    shmgen_options options;
    shmgen_status status;
    if (!settle(of, arguments))
        return -1;
    memset(&type, 0, sizeof type);
    type.name = of->type_name;
    type.digest = of->digest;
    type.size = of->size;
    type.sequence = of->sequence != 0;
    memset(&options, 0, sizeof options);
    options.group = of->group;
    options.depth = of->depth;
    options.mode = of->mode;
    options.lock_us = of->lock_ns > 0 ? (uint32_t)((of->lock_ns + 999) / 1000) : 0;
    options.passive = of->passive != 0;
    options.spin_us = of->spin_us;
    self->writes = writes;
    status = writes ? shmgen_publisher_start(&self->p, of->topic, &type, &options)
                    : shmgen_subscriber_start(&self->s, of->topic, &type, &options);
    if (status != SHMGEN_OPENING)
        return refused(self, status), -1;
    if (of->lock_ns >= 0)
        self->link.limit = of->lock_ns;
    return 0;
}

static PyObject *end_step(PyObject *object, PyObject *nothing)
{
    End *self = (End *)object;
    const bool was_open = self->link.step == SHMGEN_STEP_READY;
    const shmgen_status status = self->writes ? shmgen_publisher_step(&self->p) : shmgen_subscriber_step(&self->s);
    (void)nothing;
    if (status == SHMGEN_OK && !was_open && !self->writes && self->of.history)
        self->s.last = 0;
    return status == SHMGEN_OPENING ? PyLong_FromUnsignedLong(self->link.step) : done(self, status);
}

/* A word of the header, by its place in steps of four bytes. */
static PyObject *end_load(PyObject *object, PyObject *place)
{
    End *self = (End *)object;
    const size_t at = PyLong_AsSize_t(place);
    if (PyErr_Occurred() != NULL || !is_open(self))
        return NULL;
    if (at >= SHMGEN_HEADER_SIZE / 4)
        return PyErr_Format(PyExc_IndexError, "the header has no word %zu", at);
    return PyLong_FromUnsignedLong(shmgen_load(&self->link, 4 * at));
}

/* Whether the region's file is gone. */
static PyObject *end_is_removed(PyObject *object, PyObject *nothing)
{
    End *self = (End *)object;
    (void)nothing;
    return is_open(self) ? PyBool_FromLong(shmgen_is_removed(&self->link)) : NULL;
}

/* Whether a process has claimed the topic. */
static PyObject *end_is_claimed(PyObject *object, PyObject *nothing)
{
    End *self = (End *)object;
    (void)nothing;
    return is_open(self) ? PyBool_FromLong(shmgen_byte_is_locked(&self->link, SHMGEN_WRITER_LOCK)) : NULL;
}

static void shut(End *self)
{
    if (self->writes)
        shmgen_publisher_close(&self->p);
    else
        shmgen_subscriber_close(&self->s);
}

static PyObject *end_close(PyObject *object, PyObject *nothing)
{
    End *self = (End *)object;
    (void)nothing;
    if (!take_turn(&self->turn))
        return NULL;
    *gone(self) = SHMGEN_CLOSED;
    if (self->link.step == SHMGEN_STEP_READY)
        self->link.step = SHMGEN_STEP_CLAIM; /* who sleeps on it sees so, and leaves */
    self->turn.taken = false;
    if (!await_turn(&self->turn, true))
        return NULL;
    shut(self);
    Py_RETURN_NONE;
}

/* In a forked child: nothing of the parent's is touched, however deep inside it was. */
static PyObject *end_disown(PyObject *object, PyObject *nothing)
{
    End *self = (End *)object;
    (void)nothing;
    memset(&self->turn, 0, sizeof self->turn);
    *(self->writes ? &self->p.inside : &self->s.inside) = 0;
    self->link.passive = 1; /* also where Linux wipes no page (before 4.14), the claim is not given back */
    if (*gone(self) != SHMGEN_CLOSED) {
        shut(self);
        *gone(self) = SHMGEN_IN_FORKED_CHILD;
    }
    Py_RETURN_NONE;
}

static void end_free(PyObject *object)
{
    End *self = (End *)object;
    PyTypeObject *type = Py_TYPE(object);
    PyObject_ClearWeakRefs(object);
    if (self->of.tuple != NULL)
        shut(self);
    PyMem_Free(self->room);
    Py_XDECREF(self->of.tuple);
    Py_XDECREF(self->scratch);
    Py_XDECREF(self->nothing);
    Py_XDECREF(self->lies_in);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(object);
    Py_DECREF(type);
}

static unsigned char *take_room(End *self)
{
    unsigned char *bytes = self->room;
    self->room = NULL;
    if (bytes == NULL && (bytes = PyMem_Malloc(self->of.size)) == NULL)
        PyErr_NoMemory();
    return bytes;
}

static void give_room(End *self, unsigned char *bytes)
{
    if (self->room == NULL)
        self->room = bytes;
    else
        PyMem_Free(bytes);
}

/* --- the writer --------------------------------------------------------------------------------------------- */

static int writer_init(PyObject *object, PyObject *arguments, PyObject *names)
{
    (void)names;
    return begin_end(object, arguments, true);
}

/* Begins a sample; the interpreter's lock is given away where the region's is not free at once. */
static shmgen_status begin(End *self, int64_t limit, void **payload)
{
    shmgen_link *end = &self->link;
    shmgen_status status;
    if (limit > 0 && end->step == SHMGEN_STEP_READY && end->lock != NULL && shmgen_tokens(end->lock) < 1) {
        Py_BEGIN_ALLOW_THREADS
        status = shmgen_publisher_enter(&self->p, limit);
        Py_END_ALLOW_THREADS
        return status == SHMGEN_OK ? shmgen_publisher_place(&self->p, payload) : status;
    }
    return shmgen_publisher_begin(&self->p, limit, payload);
}

/* Publishes a message of one piece, and the arrays that lie in place of some of its bytes. False: an exception is set. */
static bool put(End *self, const unsigned char *data, const codec_late *late, size_t count, int64_t limit)
{
    const size_t size = self->of.size;
    size_t from = 0;
    void *payload = NULL;
    shmgen_status status;
    if (!take_turn(&self->turn))
        return false;
    status = begin(self, limit, &payload);
    if (status == SHMGEN_OK) {
        unsigned char *into = payload;
        for (const codec_late *one = late; one < late + count; one++) {
            memcpy(into + from, data + from, one->offset - from);
            memcpy(into + one->offset, one->view.buf, (size_t)one->view.len);
            from = one->offset + one->room;
        }
        memcpy(into + from, data + from, size - from);
        status = shmgen_publisher_complete(&self->p);
    }
    self->turn.taken = false;
    return status == SHMGEN_OK || refused(self, status) != NULL;
}

/* What Python's _encode() has put beside scratch: (offset, room, bytes), and one without room for each text it has cut. */
static bool gather(End *self, PyObject *list, codec_late *late, size_t *count)
{
    const Py_ssize_t length = PyList_Size(list);
    size_t end = 0;
    for (Py_ssize_t index = 0; index < length; index++) {
        PyObject *item = PyList_GetItem(list, index);
        codec_late *one = &late[*count];
        one->offset = PyLong_AsSize_t(PyTuple_GetItem(item, 0));
        one->room = PyLong_AsSize_t(PyTuple_GetItem(item, 1));
        if (PyErr_Occurred() != NULL)
            return false;
        if (one->room == 0) {
            self->truncations++;
            continue;
        }
        if (PyObject_GetBuffer(PyTuple_GetItem(item, 2), &one->view, PyBUF_SIMPLE) != 0)
            return false;
        ++*count;
        if (one->offset < end || (size_t)one->view.len > one->room || one->room > self->of.size - one->offset)
            return PyErr_Format(PyExc_ValueError, "a long array has changed while it was published") != NULL;
        end = one->offset + one->room;
    }
    return true;
}

/* Where the codec does not know what to do: as the generated class says, which also says what is wrong. */
static bool put_by_python(End *self, PyObject *message, int64_t limit)
{
    PyObject *scratch = self->scratch, *list = PyList_New(0), *encode = PyObject_GetAttrString(self->of.kind, "_encode");
    PyObject *made = NULL;
    codec_late *late = NULL;
    size_t count = 0;
    bool whole = false;
    self->scratch = NULL;
    if (scratch == NULL && (scratch = PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)self->of.size)) != NULL)
        memset(PyByteArray_AsString(scratch), 0, self->of.size);
    if (scratch != NULL && list != NULL && encode != NULL)
        made = PyObject_CallFunction(encode, "OOiO", message, scratch, 0, list);
    if (made != NULL && (late = PyMem_Calloc((size_t)PyList_Size(list) + 1, sizeof *late)) == NULL)
        PyErr_NoMemory();
    else if (made != NULL && gather(self, list, late, &count))
        whole = put(self, (const unsigned char *)PyByteArray_AsString(scratch), late, count, limit);
    codec_release(late, count);
    PyMem_Free(late);
    Py_XDECREF(made);
    Py_XDECREF(encode);
    Py_XDECREF(list);
    if (self->scratch == NULL)
        self->scratch = scratch;
    else
        Py_XDECREF(scratch);
    return whole;
}

static bool put_by_codec(End *self, PyObject *message, int64_t limit)
{
    codec_late late[CODEC_MOST_LATE];
    size_t count = 0, cuts = 0;
    unsigned char *bytes = take_room(self);
    int made;
    bool whole = false;
    if (bytes == NULL)
        return false;
    made = codec_encode(self->of.codec, message, bytes, late, &count, &cuts);
    if (made == 0 && (whole = put(self, bytes, late, count, limit)))
        self->truncations += cuts;
    codec_release(late, count);
    give_room(self, bytes);
    return made > 0 ? put_by_python(self, message, limit) : whole;
}

/* publish(message, left): `left` are ns of a call that ends then, None: the lock is waited for as the options say. */
static PyObject *writer_publish(PyObject *object, PyObject *const *arguments, Py_ssize_t count)
{
    End *self = (End *)object;
    shmgen_link *end = &self->link;
    int64_t limit = end->limit;
    bool whole;
    if (count < 1 || count > 2)
        return PyErr_Format(PyExc_TypeError, "publish() takes a message");
    if (end->step != SHMGEN_STEP_READY)
        return refused(self, shmgen_why(self->p.gone));
    if (count == 2 && arguments[1] != Py_None) {
        limit = shmgen_limit_within(end, PyLong_AsLongLong(arguments[1]));
        if (PyErr_Occurred() != NULL)
            return NULL;
    }
    if ((PyObject *)Py_TYPE(arguments[0]) == self->of.kind) {
        codec_buffer view;
        if (PyObject_GetBuffer(arguments[0], &view, PyBUF_SIMPLE) != 0)
            return NULL;
        whole = put(self, view.buf, NULL, 0, limit);
        PyBuffer_Release(&view);
    } else if (self->of.codec != Py_None) {
        whole = put_by_codec(self, arguments[0], limit);
    } else {
        whole = put_by_python(self, arguments[0], limit);
    }
    if (!whole)
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *writer_heartbeat(PyObject *object, PyObject *nothing)
{
    End *self = (End *)object;
    (void)nothing;
    return done(self, shmgen_publisher_heartbeat(&self->p));
}

static PyObject *writer_assure(PyObject *object, PyObject *nothing)
{
    End *self = (End *)object;
    (void)nothing;
    return done(self, shmgen_publisher_assure(&self->p));
}

/* --- the reader --------------------------------------------------------------------------------------------- */

static int reader_init(PyObject *object, PyObject *arguments, PyObject *names)
{
    End *self = (End *)object;
    (void)names;
    if (begin_end(object, arguments, false) != 0)
        return -1;
    self->nothing = PyTuple_New(0);
    self->lies_in = PyObject_GetAttrString(self->of.kind, "from_buffer");
    return self->nothing == NULL || self->lies_in == NULL ? -1 : 0;
}

/* Reads into bytes of the message's size. The interpreter's lock is given away for a wait only: where the first look did
 * not do, because the region's lock is needed and not free, or writers were quicker each time. */
static shmgen_status read_into(End *self, void *into, int64_t limit, bool next)
{
    shmgen_status (*const read)(shmgen_subscriber *, void *, size_t, int64_t, shmgen_receive) =
        next ? shmgen_subscriber_read_next : shmgen_subscriber_read;
    shmgen_status status;
    if (!take_turn(&self->turn))
        return SHMGEN_OPENING;
    status = read(&self->s, into, self->of.size, 0, NULL);
    if (limit > 0 && (status == SHMGEN_LOCK_TIMEOUT || status == SHMGEN_OVERWRITTEN)) {
        Py_BEGIN_ALLOW_THREADS
        status = read(&self->s, into, self->of.size, limit, NULL);
        Py_END_ALLOW_THREADS
    }
    self->turn.taken = false;
    return status;
}

/* Whether that is a message; else None, or an error, is to be returned. */
static bool came(const End *self, shmgen_status status)
{
    if (status != SHMGEN_OK && status != SHMGEN_NOTHING_NEW && status != SHMGEN_LOCK_TIMEOUT &&
        status != SHMGEN_OVERWRITTEN && PyErr_Occurred() == NULL)
        refused(self, status);
    return status == SHMGEN_OK;
}

static PyObject *read_long(End *self, int64_t limit, bool next)
{
    PyObject *data = PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)self->of.size), *message = NULL;
    if (data == NULL)
        return NULL;
    if (came(self, read_into(self, PyByteArray_AsString(data), limit, next)))
        message = PyObject_CallFunctionObjArgs(self->lies_in, data, NULL);
    Py_DECREF(data);
    return message;
}

static PyObject *read_short(End *self, int64_t limit, bool next)
{
    PyObject *message = self->of.make((PyTypeObject *)self->of.kind, self->nothing, NULL);
    codec_buffer view;
    bool has_come;
    if (message == NULL || PyObject_GetBuffer(message, &view, PyBUF_WRITABLE) != 0) {
        Py_XDECREF(message);
        return NULL;
    }
    has_come = came(self, read_into(self, view.buf, limit, next));
    PyBuffer_Release(&view);
    if (has_come)
        return message;
    Py_DECREF(message);
    return NULL;
}

static bool nothing_to_read(const End *self)
{
    return self->link.step == SHMGEN_STEP_READY && !shmgen_has_unread(&self->s) && !shmgen_is_retired(&self->link) &&
           !shmgen_is_inherited(&self->link);
}

static PyObject *taken(End *self, PyObject *left, bool next)
{
    int64_t limit = self->link.limit;
    PyObject *message;
    if (left != Py_None) {
        limit = shmgen_limit_within(&self->link, PyLong_AsLongLong(left));
        if (PyErr_Occurred() != NULL)
            return NULL;
    }
    if (nothing_to_read(self))
        Py_RETURN_NONE; /* without a message made for nothing */
    message = self->of.size >= LONG_FROM ? read_long(self, limit, next) : read_short(self, limit, next);
    if (message == NULL && PyErr_Occurred() == NULL)
        Py_RETURN_NONE;
    return message;
}

/* read(left): the newest message, None: there is no unread one, or it cannot be had within so many ns. */
static PyObject *reader_read(PyObject *object, PyObject *left)
{
    return taken((End *)object, left, false);
}

/* The oldest unread one that is still there. */
static PyObject *reader_next(PyObject *object, PyObject *nothing)
{
    (void)nothing;
    return taken((End *)object, Py_None, true);
}

/* Fills a message that is there already; one of another kind is filled by the codec, or as its class says. */
static bool fill_other(const End *self, const unsigned char *bytes, PyObject *message)
{
    int made = self->of.codec != Py_None ? codec_decode(self->of.codec, bytes, message) : 1;
    PyObject *found = NULL;
    if (made > 0 && PyErr_Occurred() == NULL)
        found = PyObject_CallMethod(self->of.kind, "_decode", "y#iO", (const char *)bytes, (Py_ssize_t)self->of.size, 0,
                                    message);
    Py_XDECREF(found);
    return made == 0 || found != NULL;
}

static PyObject *reader_read_into(PyObject *object, PyObject *message)
{
    End *self = (End *)object;
    unsigned char *bytes;
    bool filled = false;
    if (nothing_to_read(self))
        Py_RETURN_FALSE;
    bytes = take_room(self);
    if (bytes == NULL)
        return NULL;
    if (came(self, read_into(self, bytes, self->link.limit, false))) {
        codec_buffer view;
        if ((PyObject *)Py_TYPE(message) != self->of.kind) {
            filled = fill_other(self, bytes, message);
        } else if (PyObject_GetBuffer(message, &view, PyBUF_WRITABLE) == 0) {
            memcpy(view.buf, bytes, self->of.size);
            PyBuffer_Release(&view);
            filled = true;
        }
    }
    give_room(self, bytes);
    return PyErr_Occurred() != NULL ? NULL : PyBool_FromLong(filled);
}

/* borrow(): where the newest message lies in the region, to read it there; None: as for read(). */
static PyObject *reader_borrow(PyObject *object, PyObject *nothing)
{
    End *self = (End *)object;
    const void *payload = NULL;
    shmgen_status status;
    (void)nothing;
    if (!take_turn(&self->turn))
        return NULL;
    Py_BEGIN_ALLOW_THREADS
    status = shmgen_subscriber_borrow(&self->s, &payload);
    Py_END_ALLOW_THREADS
    self->turn.taken = false;
    if (came(self, status))
        return PyLong_FromSize_t((size_t)((const unsigned char *)payload - self->link.base));
    if (PyErr_Occurred() != NULL)
        return NULL;
    Py_RETURN_NONE;
}

/* give_back(): whether what was borrowed stayed whole, and so counts as read. */
static PyObject *reader_give_back(PyObject *object, PyObject *nothing)
{
    End *self = (End *)object;
    shmgen_status status;
    (void)nothing;
    if (!take_turn(&self->turn))
        return NULL;
    status = shmgen_subscriber_return(&self->s);
    self->turn.taken = false;
    return came(self, status) || PyErr_Occurred() == NULL ? PyBool_FromLong(status == SHMGEN_OK) : NULL;
}

/* Opens what wakes it, with the interpreter's lock: a file. */
static shmgen_status listen_to(End *self)
{
    shmgen_link *end = &self->link;
    shmgen_status status;
    if (end->step != SHMGEN_STEP_READY)
        return shmgen_why(self->s.gone);
    if (end->event != NULL)
        return SHMGEN_OK;
    end->since = shmgen_now();
    while ((status = shmgen_open_event(end)) == SHMGEN_OPENING)
        shmgen_pause(SHMGEN_MS);
    return status;
}

/* ready(ns): whether there is an unread sample, as soon as there is one or after that time. */
static PyObject *reader_ready(PyObject *object, PyObject *ns)
{
    End *self = (End *)object;
    const int64_t wanted = PyLong_AsLongLong(ns), start = shmgen_now();
    const int64_t end = wanted < INT64_MAX - start ? start + wanted : INT64_MAX;
    shmgen_status status;
    if (PyErr_Occurred() != NULL || !take_turn(&self->turn))
        return NULL;
    status = listen_to(self);
    self->turn.taken = false;
    while (status == SHMGEN_OK && !shmgen_has_unread(&self->s)) {
        shmgen_subscriber *const waits = &self->s;
        const int64_t left = end - shmgen_now();
        status = left > 0 ? shmgen_nothing_yet(waits) : shmgen_nothing(waits);
        if (status != SHMGEN_NOTHING_NEW)
            break;
        if (left <= 0)
            Py_RETURN_FALSE;
        self->turn.sleepers++;
        Py_BEGIN_ALLOW_THREADS
        shmgen_sleep(&waits, 1, left < SHMGEN_WAKE_MS * SHMGEN_MS ? left : SHMGEN_WAKE_MS * SHMGEN_MS);
        Py_END_ALLOW_THREADS
        self->turn.sleepers--;
        if (PyErr_CheckSignals() != 0)
            return NULL;
        status = self->link.step == SHMGEN_STEP_READY ? SHMGEN_OK : shmgen_why(self->s.gone);
    }
    return status == SHMGEN_OK ? PyBool_FromLong(1) : refused(self, status);
}

static PyObject *reader_skip(PyObject *object, PyObject *nothing)
{
    (void)nothing;
    shmgen_subscriber_skip(&((End *)object)->s);
    Py_RETURN_NONE;
}

/* newest(): number of the newest sample, 0 = none yet. */
static PyObject *reader_newest(PyObject *object, PyObject *nothing)
{
    End *self = (End *)object;
    (void)nothing;
    if (self->link.step != SHMGEN_STEP_READY)
        return refused(self, shmgen_why(self->s.gone));
    return PyLong_FromUnsignedLong(shmgen_newest(&self->link));
}

/* sleep_any(readers, ns): until a writer of any has something for it; may return early. They are open, and their events:
 * see ready(). */
static PyObject *sleep_any(PyObject *module, PyObject *arguments)
{
    PyObject *readers;
    shmgen_subscriber **several;
    long long ns;
    Py_ssize_t count;
    shmgen_status status = SHMGEN_OK;
    const End *last = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "O!L", &PyTuple_Type, &readers, &ns))
        return NULL;
    count = PyTuple_Size(readers);
    several = PyMem_Malloc((size_t)(count + 1) * sizeof *several);
    if (several == NULL)
        return PyErr_NoMemory();
    for (Py_ssize_t index = 0; index < count; index++) {
        End *reader = (End *)PyTuple_GetItem(readers, index);
        if ((void *)PyType_GetSlot(Py_TYPE(reader), Py_tp_init) != (void *)reader_init) {
            PyMem_Free(several);
            return PyErr_Format(PyExc_TypeError, "these are for subscribers");
        }
        several[index] = &reader->s;
        if (status == SHMGEN_OK) {
            status = listen_to(reader);
            last = reader;
        }
    }
    if (status == SHMGEN_OK) {
        for (Py_ssize_t index = 0; index < count; index++)
            ((End *)PyTuple_GetItem(readers, index))->turn.sleepers++;
        Py_BEGIN_ALLOW_THREADS
        shmgen_sleep(several, (size_t)count, ns);
        Py_END_ALLOW_THREADS
        for (Py_ssize_t index = 0; index < count; index++)
            ((End *)PyTuple_GetItem(readers, index))->turn.sleepers--;
    }
    PyMem_Free(several);
    if (status != SHMGEN_OK)
        return refused(last, status);
    Py_RETURN_NONE;
}

static PyObject *can_wait_for_many(PyObject *module, PyObject *nothing)
{
    (void)module;
    (void)nothing;
    return PyBool_FromLong(shmgen_can_wait_for_many());
}

/* --- the module --------------------------------------------------------------------------------------------- */

#define MEMBERS_OF_BOTH                                                                                                \
    {"__weaklistoffset__", T_PYSSIZET, offsetof(End, weak), READONLY, NULL},                                           \
        {"lock_misses", T_UINT, offsetof(End, link.misses), READONLY, NULL}

#define METHODS_OF_BOTH                                                                                                \
    {"step", end_step, METH_NOARGS, NULL}, {"load", end_load, METH_O, NULL},                                           \
        {"is_removed", end_is_removed, METH_NOARGS, NULL}, {"is_claimed", end_is_claimed, METH_NOARGS, NULL},          \
        {"close", end_close, METH_NOARGS, NULL}, {"disown", end_disown, METH_NOARGS, NULL}

static PyMemberDef writer_members[] = {
    MEMBERS_OF_BOTH,
    {"sequence", T_UINT, offsetof(End, p.sequence), 0, NULL},
    {"doubtful", T_UINT, offsetof(End, p.jump), 0, NULL},
    {"truncations", T_ULONGLONG, offsetof(End, truncations), READONLY, NULL},
    {NULL, 0, 0, 0, NULL},
};

static PyMethodDef writer_methods[] = {
    METHODS_OF_BOTH,
    {"publish", (PyCFunction)(void (*)(void))writer_publish, METH_FASTCALL, NULL},
    {"heartbeat", writer_heartbeat, METH_NOARGS, NULL},
    {"assure", writer_assure, METH_NOARGS, NULL},
    {NULL, NULL, 0, NULL},
};

static PyMemberDef reader_members[] = {
    MEMBERS_OF_BOTH,
    {"sequence", T_UINT, offsetof(End, s.sequence), READONLY, NULL},
    {"file", T_INT, offsetof(End, link.file), READONLY, NULL},
    {"last", T_UINT, offsetof(End, s.last), 0, NULL},
    {"beat", T_UINT, offsetof(End, s.beat), READONLY, NULL}, /* heartbeat as it was at the opening */
    {"stamp", T_ULONGLONG, offsetof(End, s.stamp), READONLY, NULL},
    {"missed", T_ULONGLONG, offsetof(End, s.missed), READONLY, NULL},
    {NULL, 0, 0, 0, NULL},
};

static PyMethodDef reader_methods[] = {
    METHODS_OF_BOTH,
    {"read", reader_read, METH_O, NULL},
    {"next", reader_next, METH_NOARGS, NULL},
    {"read_into", reader_read_into, METH_O, NULL},
    {"ready", reader_ready, METH_O, NULL},
    {"skip", reader_skip, METH_NOARGS, NULL},
    {"newest", reader_newest, METH_NOARGS, NULL},
    {"borrow", reader_borrow, METH_NOARGS, NULL},
    {"give_back", reader_give_back, METH_NOARGS, NULL},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot writer_slots[] = {
    {Py_tp_init, (void *)writer_init},
    {Py_tp_members, writer_members},
    {Py_tp_methods, writer_methods},
    {Py_tp_dealloc, (void *)end_free},
    {0, NULL},
};

static PyType_Slot reader_slots[] = {
    {Py_tp_init, (void *)reader_init},
    {Py_tp_members, reader_members},
    {Py_tp_methods, reader_methods},
    {Py_tp_dealloc, (void *)end_free},
    {0, NULL},
};

static PyType_Spec specifications[] = {
    {"shmgen._core.Writer", (int)sizeof(End), 0, Py_TPFLAGS_DEFAULT, writer_slots},
    {"shmgen._core.Reader", (int)sizeof(End), 0, Py_TPFLAGS_DEFAULT, reader_slots},
};

static int fill(PyObject *module)
{
    static const char *const names[] = {"Writer", "Reader"};
    for (int number = 0; number < 2; number++) {
        PyObject *type = PyType_FromSpec(&specifications[number]);
        if (type == NULL || PyModule_AddObject(module, names[number], type) != 0) {
            Py_XDECREF(type);
            return -1;
        }
    }
    if (codec_fill(module) != 0)
        return -1;
    return PyModule_AddIntConstant(module, "ABI", SHMGEN_ABI);
}

/* Takes the function that makes an error of a status. */
static PyObject *explain_by(PyObject *module, PyObject *function)
{
    PyObject *former = explainer;
    (void)module;
    Py_INCREF(function);
    explainer = function;
    Py_XDECREF(former);
    Py_RETURN_NONE;
}

static PyMethodDef functions[] = {
    {"explain_by", explain_by, METH_O, NULL},
    {"sleep_any", sleep_any, METH_VARARGS, NULL},
    {"can_wait_for_many", can_wait_for_many, METH_NOARGS, NULL},
    {NULL, NULL, 0, NULL},
};

static PyModuleDef_Slot module_slots[] = {
    {Py_mod_exec, (void *)fill},
    {0, NULL},
};

static PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_core", NULL, 0, functions, module_slots, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__core(void)
{
    return PyModuleDef_Init(&definition);
}
