/* The engine in C for Python: the types Writer, Reader and Notifier, and one sleep on many readers.
 *
 * The C headers of templates/c implement the protocol. A call that has to wait releases the GIL. No Python code
 * runs while a call holds the lock of the region. So a signal handler, a property or another thread can safely
 * publish on the same publisher. This file uses the limited API of CPython: one binary works for 3.10 and later
 * versions. runtime/reference/ is the same engine in Python.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <structmember.h>

#include "shmgen_notifier.h"
#include "shmgen_runtime.h"

#include "table.h"

#define LONG_FROM 4096 /* size in bytes from which a message that is read is a view of a bytearray */

/* The settings of an endpoint. All pointers point into the Python tuple. */
typedef struct Settings {
    PyObject *tuple, *kind, *codec;
    newfunc make; /* creates a message without its defaults */
    const char *topic;
    shmgen_type type;
    shmgen_options options;
    unsigned int pid;
    long long lock_ns; /* -1 selects the default timeout */
    int history, reopen;
} Settings;

/* --- threads ------------------------------------------------------------------------------------------------ */

/* The calls of an endpoint that run without the GIL. */
typedef struct CallGuard {
    unsigned int sleepers; /* number of calls that only read header fields; many may run at once */
    bool is_held;            /* true while a call changes the endpoint; only one may run */
} CallGuard;

/* Let other threads run for 0.1 ms. Return false if a signal handler has raised an exception. */
static bool pause_for_others(void)
{
    Py_BEGIN_ALLOW_THREADS
    shmgen_pause(SHMGEN_MS / 10);
    Py_END_ALLOW_THREADS
    return PyErr_CheckSignals() == 0;
}

/* Wait until the call of another thread ends and, if `sleepers` is true, until no call sleeps. Return false if a
 * signal handler has raised an exception. */
static bool await_guard(const CallGuard *guard, bool sleepers)
{
    while (guard->is_held || (sleepers && guard->sleepers != 0))
        if (!pause_for_others())
            return false;
    return true;
}

/* Wait until no other call changes the endpoint, and acquire the guard. Return false with an exception set. */
static bool acquire_guard(CallGuard *guard)
{
    if (!await_guard(guard, false))
        return false;
    guard->is_held = true;
    return true;
}

/* --- the writer and the reader ------------------------------------------------------------------------------- */

/* A Writer or a Reader. A call takes the member `buffer`, so a second call inside of the first allocates another
 * buffer. */
typedef struct End {
    PyObject_HEAD
    PyObject *weak;
    Settings of;
    CallGuard guard;
    unsigned char *buffer; /* a buffer for one message */
    bool writes;
    bool is_logged; /* true once the first reopening is logged */
    union {
        shmgen_link link; /* the first member of both structures */
        shmgen_publisher p;
        shmgen_subscriber s;
    };
    unsigned long long truncations;
    PyObject *nothing; /* an empty tuple, to create a message without its defaults */
    PyObject *lies_in; /* kind.from_buffer, for large messages */
} End;

static shmgen_status *closed_status(End *self)
{
    return self->writes ? &self->p.closed_status : &self->s.closed_status;
}

/* The module that creates errors and log messages. A call loads the module when it first needs one. */
static PyObject *refusals(void)
{
    return PyImport_ImportModule("shmgen.runtime.refusals");
}

/* Raise the Python error for the status. */
static PyObject *raise_status(const End *self, shmgen_status status)
{
    const int number = errno;
    PyObject *module = refusals(), *error = NULL;
    if (module != NULL)
        error = PyObject_CallMethod(module, "refusal", "OiIi", self->of.tuple, (int)status, self->of.pid, number);
    if (error != NULL)
        PyErr_SetObject((PyObject *)Py_TYPE(error), error);
    Py_XDECREF(error);
    Py_XDECREF(module);
    return NULL;
}

static PyObject *none_or_raise(const End *self, shmgen_status status)
{
    if (status != SHMGEN_OK)
        return raise_status(self, status);
    Py_RETURN_NONE;
}

static shmgen_status take_step(End *self)
{
    const bool was_open = self->link.step == SHMGEN_STEP_READY;
    const shmgen_status status = self->writes ? shmgen_publisher_step(&self->p) : shmgen_subscriber_step(&self->s);
    if (status == SHMGEN_OK && !was_open && !self->writes && self->of.history)
        self->s.last = 0;
    return status;
}

/* Return true if the caller must repeat a call that ended with `*status`: the region was removed, and is open again or
 * about to be. Take all steps of reopening that do not wait. The caller must hold the guard. Threads that sleep on the
 * removed region must return first, which takes up to SHMGEN_WAKE_MS. */
static bool is_reopening(End *self, shmgen_status *status)
{
    uint32_t step;
    if (*status == SHMGEN_OK || !self->of.reopen || self->link.lost == 0)
        return false;
    *status = SHMGEN_OPENING;
    if (self->guard.sleepers != 0)
        return true;
    do {
        step = self->link.step;
        *status = take_step(self);
    } while (*status == SHMGEN_OPENING && self->link.step != step);
    return *status == SHMGEN_OPENING || *status == SHMGEN_OK;
}

/* Log why the region was recreated, which runs Python code. */
static bool log_recreated(const End *self, uint32_t status)
{
    PyObject *module = refusals(), *logged = NULL;
    if (module != NULL)
        logged = PyObject_CallMethod(module, "log_recreated", "OI", self->of.tuple, status);
    Py_XDECREF(logged);
    Py_XDECREF(module);
    return logged != NULL;
}

/* Release the guard, and log the first reopening of the region, which runs Python code. */
static bool release_guard(End *self)
{
    self->guard.is_held = false;
    if (self->link.reopen_count == 0 || self->is_logged)
        return true;
    self->is_logged = true;
    return log_recreated(self, SHMGEN_REGION_RETIRED);
}

/* Return true if the endpoint is open, and false while its region is being reopened. If the endpoint is closed, return
 * false with an exception. */
static bool is_open(End *self)
{
    shmgen_status status = self->link.step == SHMGEN_STEP_READY ? SHMGEN_OK : shmgen_closed_reason(*closed_status(self));
    if (status == SHMGEN_OK)
        return true;
    if (self->guard.is_held || is_reopening(self, &status))
        return self->link.step == SHMGEN_STEP_READY;
    return raise_status(self, status) != NULL;
}

/* Read the settings. The strings are valid as long as the tuple exists. */
static bool read_settings(Settings *of, PyObject *arguments)
{
    const char *word;
    PyObject *tuple, *header;
    shmgen_type *type = &of->type;
    shmgen_options *options = &of->options;
    if (!PyArg_ParseTuple(arguments, "O!", &PyTuple_Type, &tuple) ||
        !PyArg_ParseTuple(tuple, "sOOsKIILIsIIppIsO", &of->topic, &of->kind, &of->codec, &type->name, &type->digest,
                          &type->size, &options->depth, &of->lock_ns, &options->mode, &options->group, &type->sequence,
                          &options->passive, &of->history, &of->reopen, &options->spin_us, &word, &header))
        return false;
    of->make = (newfunc)PyType_GetSlot((PyTypeObject *)of->kind, Py_tp_new);
    of->pid = (unsigned int)getpid();
    of->tuple = tuple;
    Py_INCREF(tuple);
    return true;
}

/* Start to open the region. */
static bool start_end(End *self, bool writes)
{
    Settings *of = &self->of;
    shmgen_status status;
    self->writes = writes;
    status = writes ? shmgen_publisher_start(&self->p, of->topic, &of->type, &of->options)
                    : shmgen_subscriber_start(&self->s, of->topic, &of->type, &of->options);
    if (status != SHMGEN_OPENING)
        return raise_status(self, status) != NULL;
    if (of->lock_ns >= 0)
        self->link.limit = of->lock_ns;
    return true;
}

/* Create a Writer or a Reader that starts to open its region. */
static End *begin_end(PyTypeObject *type, PyObject *arguments, bool writes)
{
    End *self = (End *)((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0);
    if (self == NULL)
        return NULL;
    if (read_settings(&self->of, arguments) && start_end(self, writes))
        return self;
    Py_DECREF(self);
    return NULL;
}

static PyObject *end_step(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    End *self = (End *)object;
    const shmgen_status status = take_step(self);
    const uint32_t outdated = self->link.outdated;
    if (status == SHMGEN_OK && outdated != SHMGEN_OK) {
        self->link.outdated = SHMGEN_OK;
        if (!log_recreated(self, outdated))
            return NULL;
    }
    return status == SHMGEN_OPENING ? PyLong_FromUnsignedLong(self->link.step) : none_or_raise(self, status);
}

/* load(place): return a header field by its position in steps of four bytes, or 0 while the region is being
 * reopened. */
static PyObject *end_load(PyObject *object, PyObject *place)
{
    End *self = (End *)object;
    const size_t at = PyLong_AsSize_t(place);
    if (PyErr_Occurred() != NULL)
        return NULL;
    if (!is_open(self))
        return PyErr_Occurred() != NULL ? NULL : PyLong_FromLong(0);
    if (at >= SHMGEN_HEADER_SIZE / 4)
        return PyErr_Format(PyExc_IndexError, "the header has no word %zu", at);
    return PyLong_FromUnsignedLong(shmgen_load(&self->link, 4 * at));
}

/* is_claimed(): return True if a process has claimed the topic. */
static PyObject *end_is_claimed(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    End *self = (End *)object;
    if (!is_open(self))
        return PyErr_Occurred() != NULL ? NULL : PyBool_FromLong(0);
    return PyBool_FromLong(shmgen_byte_is_locked(&self->link, SHMGEN_WRITER_LOCK));
}

static void close_end(End *self)
{
    if (self->writes)
        shmgen_publisher_close(&self->p);
    else
        shmgen_subscriber_close(&self->s);
}

static PyObject *end_close(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    End *self = (End *)object;
    if (!acquire_guard(&self->guard))
        return NULL;
    *closed_status(self) = SHMGEN_CLOSED;
    if (self->link.step == SHMGEN_STEP_READY)
        self->link.step = SHMGEN_STEP_CLAIM; /* calls that sleep on the region see this step and return */
    self->guard.is_held = false;
    if (!await_guard(&self->guard, true))
        return NULL;
    close_end(self);
    Py_RETURN_NONE;
}

/* close_in_child(): close the endpoint in a forked child, without changing anything that belongs to the parent. */
static PyObject *end_close_in_child(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    End *self = (End *)object;
    memset(&self->guard, 0, sizeof self->guard);
    *(self->writes ? &self->p.inside : &self->s.inside) = 0;
    self->link.passive = 1; /* keeps the claim of the parent, even before Linux 4.14, which wipes no page */
    /* If the fork interrupted a close() that waits for other threads, the status is set, but the region is open. */
    if (*closed_status(self) != SHMGEN_CLOSED || self->link.step != SHMGEN_STEP_CLOSED) {
        close_end(self);
        *closed_status(self) = SHMGEN_IN_FORKED_CHILD;
    }
    Py_RETURN_NONE;
}

static void end_free(PyObject *object)
{
    End *self = (End *)object;
    PyTypeObject *type = Py_TYPE(object);
    PyObject_ClearWeakRefs(object);
    if (self->of.tuple != NULL)
        close_end(self);
    PyMem_Free(self->buffer);
    Py_XDECREF(self->of.tuple);
    Py_XDECREF(self->nothing);
    Py_XDECREF(self->lies_in);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(object);
    Py_DECREF(type);
}

/* Take the buffer of the endpoint, or allocate one if another call uses it. */
static unsigned char *take_buffer(End *self)
{
    unsigned char *bytes = self->buffer;
    self->buffer = NULL;
    if (bytes == NULL && (bytes = PyMem_Malloc(self->of.type.size)) == NULL)
        PyErr_NoMemory();
    return bytes;
}

/* Return a buffer to the endpoint, or free the buffer. */
static void give_back_buffer(End *self, unsigned char *bytes)
{
    if (self->buffer == NULL)
        self->buffer = bytes;
    else
        PyMem_Free(bytes);
}

/* --- the writer --------------------------------------------------------------------------------------------- */

static PyObject *writer_new(PyTypeObject *type, PyObject *arguments, PyObject *Py_UNUSED(names))
{
    return (PyObject *)begin_end(type, arguments, true);
}

/* Begin a sample. Release the GIL while waiting for the lock of the region. */
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

/* Write the message `data`, and copy the deferred arrays over the bytes that they replace. */
static shmgen_status write_pieces(
    End *self, const unsigned char *data, const codec_deferred *deferred, size_t count, int64_t limit)
{
    void *payload = NULL;
    unsigned char *into;
    size_t from = 0;
    const shmgen_status status = begin(self, limit, &payload);
    if (status != SHMGEN_OK)
        return status;
    into = payload;
    for (const codec_deferred *one = deferred; one < deferred + count; one++) {
        memcpy(into + from, data + from, one->offset - from);
        memcpy(into + one->offset, one->view.buf, (size_t)one->view.len);
        memset(into + one->offset + one->view.len, 0, one->room - (size_t)one->view.len);
        from = one->offset + one->room;
    }
    memcpy(into + from, data + from, self->of.type.size - from);
    return shmgen_publisher_complete(&self->p);
}

/* Publish a message, and wait while the region is being reopened. Return false with an exception. */
static bool publish_bytes(End *self, const unsigned char *data, const codec_deferred *deferred, size_t count, int64_t limit)
{
    while (acquire_guard(&self->guard)) {
        shmgen_status status = write_pieces(self, data, deferred, count, limit);
        if (status == SHMGEN_OK)
            return release_guard(self);
        if (!is_reopening(self, &status))
            return release_guard(self) && raise_status(self, status) != NULL;
        if (!release_guard(self) || (status == SHMGEN_OPENING && !pause_for_others()))
            return false;
    }
    return false;
}

static bool publish_encoded(End *self, PyObject *message, int64_t limit)
{
    codec_deferred deferred[CODEC_MOST_DEFERRED];
    size_t count = 0, cuts = 0;
    unsigned char *bytes = take_buffer(self);
    bool whole = false;
    if (bytes == NULL)
        return false;
    if (codec_encode(self->of.codec, message, bytes, deferred, &count, &cuts) && (whole = publish_bytes(self, bytes, deferred, count, limit)))
        self->truncations += cuts;
    codec_release(deferred, count);
    give_back_buffer(self, bytes);
    return whole;
}

/* publish(message, left): publish a message. `left` is the time left in ns to wait for the lock. None selects the
 * timeout in the options. */
static PyObject *writer_publish(PyObject *object, PyObject *const *arguments, Py_ssize_t count)
{
    End *self = (End *)object;
    shmgen_link *end = &self->link;
    int64_t limit = end->limit;
    bool whole;
    if (count < 1 || count > 2)
        return PyErr_Format(PyExc_TypeError, "publish() takes one message");
    if (end->step != SHMGEN_STEP_READY && end->lost == 0)
        return raise_status(self, shmgen_closed_reason(self->p.closed_status));
    if (count == 2 && arguments[1] != Py_None) {
        limit = shmgen_limit_within(end, PyLong_AsLongLong(arguments[1]));
        if (PyErr_Occurred() != NULL)
            return NULL;
    }
    if ((PyObject *)Py_TYPE(arguments[0]) == self->of.kind) {
        codec_buffer view;
        if (PyObject_GetBuffer(arguments[0], &view, PyBUF_SIMPLE) != 0)
            return NULL;
        whole = publish_bytes(self, view.buf, NULL, 0, limit);
        PyBuffer_Release(&view);
    } else if (self->of.codec != Py_None) {
        whole = publish_encoded(self, arguments[0], limit);
    } else {
        return PyErr_Format(PyExc_TypeError, "%R has no table of fields: publish an object of it", self->of.kind);
    }
    if (!whole)
        return NULL;
    Py_RETURN_NONE;
}

/* Call `call`, which may lose the topic and unmap the region. Hold the guard, because another thread may wait for the
 * lock in the unmapped memory. Do not wait while the region is being reopened. */
static PyObject *call_guarded(End *self, shmgen_status (*call)(shmgen_publisher *))
{
    shmgen_status status;
    if (!acquire_guard(&self->guard))
        return NULL;
    status = call(&self->p);
    if (is_reopening(self, &status))
        status = SHMGEN_OK;
    return release_guard(self) ? none_or_raise(self, status) : NULL;
}

static PyObject *writer_heartbeat(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    End *self = (End *)object;
    if (self->guard.is_held && self->link.step == SHMGEN_STEP_READY && shmgen_is_mine(&self->p)) {
        shmgen_store(&self->link, SHMGEN_AT(heartbeat), ++self->p.beat); /* works even while another thread waits */
        Py_RETURN_NONE;
    }
    return call_guarded(self, shmgen_publisher_heartbeat);
}

static PyObject *writer_check_claim(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    return call_guarded((End *)object, shmgen_publisher_check_claim);
}

/* --- the reader --------------------------------------------------------------------------------------------- */

static PyObject *reader_new(PyTypeObject *type, PyObject *arguments, PyObject *Py_UNUSED(names))
{
    End *self = begin_end(type, arguments, false);
    if (self == NULL)
        return NULL;
    self->nothing = PyTuple_New(0);
    self->lies_in = PyObject_GetAttrString(self->of.kind, "from_buffer");
    if (self->nothing != NULL && self->lies_in != NULL)
        return (PyObject *)self;
    Py_DECREF(self);
    return NULL;
}

static bool is_reader(PyObject *object)
{
    return PyType_GetSlot(Py_TYPE(object), Py_tp_new) == (void *)reader_new;
}

/* Read a sample into a buffer of the message's size. Release the GIL only for a second try: the lock of the region
 * was needed and not free, or the writer was faster each time. */
static shmgen_status read_into(End *self, void *into, int64_t limit, bool next)
{
    shmgen_status (*const read)(shmgen_subscriber *, void *, size_t, int64_t, shmgen_receive) =
        next ? shmgen_subscriber_read_next : shmgen_subscriber_read;
    shmgen_status status;
    if (!acquire_guard(&self->guard))
        return SHMGEN_OPENING;
    status = read(&self->s, into, self->of.type.size, 0, NULL);
    if (limit > 0 && (status == SHMGEN_LOCK_TIMEOUT || status == SHMGEN_OVERWRITTEN)) {
        Py_BEGIN_ALLOW_THREADS
        status = read(&self->s, into, self->of.type.size, limit, NULL);
        Py_END_ALLOW_THREADS
    }
    if (is_reopening(self, &status))
        status = SHMGEN_NOTHING_NEW;
    return release_guard(self) ? status : SHMGEN_OPENING;
}

/* Return true if the status means that a message was read. Otherwise the caller returns None or an error. */
static bool is_message(const End *self, shmgen_status status)
{
    if (status != SHMGEN_OK && !shmgen_is_none_now(status) && PyErr_Occurred() == NULL)
        raise_status(self, status);
    return status == SHMGEN_OK;
}

static PyObject *read_long(End *self, int64_t limit, bool next)
{
    PyObject *data = PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)self->of.type.size), *message = NULL;
    if (data == NULL)
        return NULL;
    if (is_message(self, read_into(self, PyByteArray_AsString(data), limit, next)))
        message = PyObject_CallFunctionObjArgs(self->lies_in, data, NULL);
    Py_DECREF(data);
    return message;
}

static PyObject *read_short(End *self, int64_t limit, bool next)
{
    PyObject *message = self->of.make((PyTypeObject *)self->of.kind, self->nothing, NULL);
    codec_buffer view;
    bool is_read;
    if (message == NULL || PyObject_GetBuffer(message, &view, PyBUF_WRITABLE) != 0) {
        Py_XDECREF(message);
        return NULL;
    }
    is_read = is_message(self, read_into(self, view.buf, limit, next));
    PyBuffer_Release(&view);
    if (is_read)
        return message;
    Py_DECREF(message);
    return NULL;
}

static bool nothing_to_read(End *self)
{
    return self->link.step == SHMGEN_STEP_READY && !shmgen_has_unread(&self->s) && !shmgen_is_inherited(&self->link) &&
           shmgen_nothing(&self->s) == SHMGEN_NOTHING_NEW;
}

static PyObject *read_message(End *self, PyObject *left, bool next)
{
    int64_t limit = self->link.limit;
    PyObject *message;
    if (left != Py_None) {
        limit = shmgen_limit_within(&self->link, PyLong_AsLongLong(left));
        if (PyErr_Occurred() != NULL)
            return NULL;
    }
    if (nothing_to_read(self))
        Py_RETURN_NONE; /* before a message is created */
    message = self->of.type.size >= LONG_FROM ? read_long(self, limit, next) : read_short(self, limit, next);
    if (message == NULL && PyErr_Occurred() == NULL)
        Py_RETURN_NONE;
    return message;
}

/* read(left): return the newest message. Return None if it was read already, or cannot be read within `left` ns. */
static PyObject *reader_read(PyObject *object, PyObject *left)
{
    return read_message((End *)object, left, false);
}

/* next(): return the oldest unread message that is still in the region. */
static PyObject *reader_next(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    return read_message((End *)object, Py_None, true);
}

/* Set the fields of a message of another class. */
static bool fill_other(const End *self, const unsigned char *bytes, PyObject *message)
{
    if (self->of.codec != Py_None)
        return codec_decode(self->of.codec, bytes, message);
    return PyErr_Format(PyExc_TypeError, "%R has no table of fields: read into an object of it", self->of.kind) != NULL;
}

static PyObject *reader_read_into(PyObject *object, PyObject *message)
{
    End *self = (End *)object;
    unsigned char *bytes;
    bool filled = false;
    if (nothing_to_read(self))
        Py_RETURN_FALSE;
    bytes = take_buffer(self);
    if (bytes == NULL)
        return NULL;
    if (is_message(self, read_into(self, bytes, self->link.limit, false))) {
        codec_buffer view;
        if ((PyObject *)Py_TYPE(message) != self->of.kind) {
            filled = fill_other(self, bytes, message);
        } else if (PyObject_GetBuffer(message, &view, PyBUF_WRITABLE) == 0) {
            memcpy(view.buf, bytes, self->of.type.size);
            PyBuffer_Release(&view);
            filled = true;
        }
    }
    give_back_buffer(self, bytes);
    return PyErr_Occurred() != NULL ? NULL : PyBool_FromLong(filled);
}

/* borrow(): return the offset of the newest message in the region, to read it in place. Return None like read(). */
static PyObject *reader_borrow(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    End *self = (End *)object;
    const void *payload = NULL;
    shmgen_status status;
    if (!acquire_guard(&self->guard))
        return NULL;
    Py_BEGIN_ALLOW_THREADS
    status = shmgen_subscriber_borrow(&self->s, &payload);
    Py_END_ALLOW_THREADS
    if (is_reopening(self, &status))
        status = SHMGEN_NOTHING_NEW;
    if (!release_guard(self))
        return NULL;
    if (is_message(self, status))
        return PyLong_FromSize_t((size_t)((const unsigned char *)payload - self->link.base));
    if (PyErr_Occurred() != NULL)
        return NULL;
    Py_RETURN_NONE;
}

/* give_back(): return True if the borrowed message stayed complete. It then counts as read. */
static PyObject *reader_give_back(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    End *self = (End *)object;
    shmgen_status status;
    if (!acquire_guard(&self->guard))
        return NULL;
    status = shmgen_subscriber_return(&self->s);
    self->guard.is_held = false;
    return is_message(self, status) || PyErr_Occurred() == NULL ? PyBool_FromLong(status == SHMGEN_OK) : NULL;
}

/* Open the event that wakes the reader, a file. Keeps the GIL. */
static shmgen_status listen_to(End *self)
{
    shmgen_link *end = &self->link;
    shmgen_status status;
    if (end->step != SHMGEN_STEP_READY)
        return shmgen_closed_reason(self->s.closed_status);
    if (end->event != NULL)
        return SHMGEN_OK;
    end->since = shmgen_now();
    while ((status = shmgen_open_event(end)) == SHMGEN_OPENING)
        shmgen_pause(SHMGEN_MS);
    return status;
}

/* Check for an unread sample. SHMGEN_NOTHING_NEW: there is none. SHMGEN_OPENING: the region is being reopened. */
static shmgen_status look(End *self)
{
    shmgen_status status = listen_to(self);
    if (status == SHMGEN_OK && !shmgen_has_unread(&self->s))
        status = shmgen_nothing(&self->s);
    if (is_reopening(self, &status))
        status = SHMGEN_OPENING;
    return release_guard(self) ? status : SHMGEN_CLOSED;
}

/* ready(ns): wait at most `ns` for an unread sample. Return True if there is one. */
static PyObject *reader_ready(PyObject *object, PyObject *ns)
{
    End *self = (End *)object;
    shmgen_subscriber *const waits = &self->s;
    const int64_t timeout = PyLong_AsLongLong(ns), start = shmgen_now();
    const int64_t end = timeout < INT64_MAX - start ? start + timeout : INT64_MAX;
    while (PyErr_Occurred() == NULL && acquire_guard(&self->guard)) {
        const shmgen_status status = look(self);
        const int64_t left = end - shmgen_now();
        if (PyErr_Occurred() != NULL)
            return NULL;
        if (status != SHMGEN_NOTHING_NEW && status != SHMGEN_OPENING)
            return status == SHMGEN_OK ? PyBool_FromLong(1) : raise_status(self, status);
        if (left <= 0)
            return PyBool_FromLong(0);
        if (status == SHMGEN_OPENING) {
            if (!pause_for_others())
                return NULL;
            continue;
        }
        self->guard.sleepers++;
        Py_BEGIN_ALLOW_THREADS
        shmgen_sleep(&waits, 1, left < SHMGEN_WAKE_MS * SHMGEN_MS ? left : SHMGEN_WAKE_MS * SHMGEN_MS);
        Py_END_ALLOW_THREADS
        self->guard.sleepers--;
        if (PyErr_CheckSignals() != 0)
            return NULL;
    }
    return NULL;
}

/* check(): check whether the region was removed, once in SHMGEN_REMOVED_MS. */
static PyObject *reader_check(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    End *self = (End *)object;
    if (is_open(self) && !self->guard.is_held) {
        shmgen_status status = shmgen_nothing(&self->s);
        (void)is_reopening(self, &status);
    }
    if (PyErr_Occurred() != NULL)
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *reader_skip(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    shmgen_subscriber_skip(&((End *)object)->s);
    Py_RETURN_NONE;
}

/* newest(): return the number of the newest sample, or 0 if there is none yet. */
static PyObject *reader_newest(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    End *self = (End *)object;
    if (!is_open(self))
        return PyErr_Occurred() != NULL ? NULL : PyLong_FromLong(0);
    if (!shmgen_has_unread(&self->s))
        (void)shmgen_nothing(&self->s);
    return PyLong_FromUnsignedLong(shmgen_newest(&self->link));
}

/* sleep_any(readers, ns): sleep at most `ns` until a writer may have published a sample. May return early. */
static PyObject *sleep_any(PyObject *Py_UNUSED(module), PyObject *arguments)
{
    PyObject *readers;
    shmgen_subscriber **several;
    long long ns;
    Py_ssize_t count;
    shmgen_status status = SHMGEN_OK;
    const End *last = NULL;
    if (!PyArg_ParseTuple(arguments, "O!L", &PyTuple_Type, &readers, &ns))
        return NULL;
    count = PyTuple_Size(readers);
    several = PyMem_Malloc((size_t)(count + 1) * sizeof *several);
    if (several == NULL)
        return PyErr_NoMemory();
    for (Py_ssize_t index = 0; index < count; index++) {
        End *reader = (End *)PyTuple_GetItem(readers, index);
        if (!is_reader((PyObject *)reader)) {
            PyMem_Free(several);
            return PyErr_Format(PyExc_TypeError, "each argument must be a subscriber");
        }
        several[index] = &reader->s;
        if (status == SHMGEN_OK && (reader->link.step == SHMGEN_STEP_READY || reader->link.lost == 0)) {
            status = listen_to(reader);
            last = reader;
        }
    }
    if (status == SHMGEN_OK) {
        for (Py_ssize_t index = 0; index < count; index++)
            ((End *)PyTuple_GetItem(readers, index))->guard.sleepers++;
        Py_BEGIN_ALLOW_THREADS
        shmgen_sleep(several, (size_t)count, ns);
        Py_END_ALLOW_THREADS
        for (Py_ssize_t index = 0; index < count; index++)
            ((End *)PyTuple_GetItem(readers, index))->guard.sleepers--;
    }
    PyMem_Free(several);
    if (status != SHMGEN_OK)
        return raise_status(last, status);
    Py_RETURN_NONE;
}

/* --- the notifier ------------------------------------------------------------------------------------------- */

typedef struct Notifier {
    PyObject_HEAD
    PyObject *weak;
    PyObject *readers; /* a dict that keeps the watched readers alive */
    shmgen_notifier c;
} Notifier;

static int notifier_init(PyObject *object, PyObject *arguments, PyObject *Py_UNUSED(names))
{
    Notifier *self = (Notifier *)object;
    if (self->readers != NULL || !PyArg_ParseTuple(arguments, ""))
        return -1;
    self->c.fd = -1;
    self->readers = PyDict_New();
    if (self->readers == NULL)
        return -1;
    if (shmgen_notifier_open(&self->c) == SHMGEN_OK)
        return 0;
    PyErr_SetFromErrno(PyExc_OSError);
    return -1;
}

/* Return the reader, or NULL with an exception. */
static End *reader_for(const Notifier *self, PyObject *reader)
{
    if (!is_reader(reader))
        PyErr_Format(PyExc_TypeError, "a notifier watches only subscribers");
    else if (self->readers == NULL || self->c.fd < 0)
        PyErr_Format(PyExc_ValueError, "this notifier is closed");
    else
        return (End *)reader;
    return NULL;
}

/* add(reader): report the samples of a reader from now on. Adding a reader again changes nothing. Return False while
 * the region of the reader is being reopened; add the reader later. */
static PyObject *notifier_add(PyObject *object, PyObject *reader)
{
    Notifier *self = (Notifier *)object;
    End *end = reader_for(self, reader);
    shmgen_status status;
    if (end != NULL && PyDict_GetItem(self->readers, reader) != NULL)
        Py_RETURN_TRUE;
    if (end != NULL && !is_open(end))
        return PyErr_Occurred() != NULL ? NULL : PyBool_FromLong(0);
    if (end == NULL || PyDict_SetItem(self->readers, reader, Py_None) != 0)
        return NULL;
    status = shmgen_notifier_add(&self->c, &end->s);
    if (status == SHMGEN_OK)
        Py_RETURN_TRUE;
    if (PyDict_DelItem(self->readers, reader) != 0)
        return NULL;
    return status == SHMGEN_NOTIFIER_FAILED ? PyErr_SetFromErrno(PyExc_OSError) : raise_status(end, status);
}

/* remove(reader): stop reporting the samples of a reader. */
static PyObject *notifier_remove(PyObject *object, PyObject *reader)
{
    Notifier *self = (Notifier *)object;
    End *end = reader_for(self, reader);
    if (end == NULL)
        return NULL;
    if (PyDict_GetItem(self->readers, reader) != NULL) {
        shmgen_notifier_remove(&self->c, &end->s);
        if (PyDict_DelItem(self->readers, reader) != 0)
            return NULL;
    }
    Py_RETURN_NONE;
}

/* ready(): return the readers with samples that were not reported yet. The descriptor is then not readable. */
static PyObject *notifier_ready(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    Notifier *self = (Notifier *)object;
    PyObject *ready = PyList_New(0);
    shmgen_subscriber *subscriber;
    while (ready != NULL && self->c.fd >= 0 && (subscriber = shmgen_notifier_next(&self->c)) != NULL)
        if (PyList_Append(ready, (PyObject *)(void *)((char *)subscriber - offsetof(End, s))) != 0)
            Py_CLEAR(ready);
    return ready;
}

static PyObject *notifier_fileno(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    return PyLong_FromLong(((Notifier *)object)->c.fd);
}

static PyObject *notifier_close(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    Notifier *self = (Notifier *)object;
    if (self->readers != NULL) {
        Py_BEGIN_ALLOW_THREADS
        shmgen_notifier_close(&self->c);
        Py_END_ALLOW_THREADS
        PyDict_Clear(self->readers);
    }
    Py_RETURN_NONE;
}

/* close_in_child(): close the descriptor in a forked child, which has no thread. Leave the rest to the parent. */
static PyObject *notifier_close_in_child(PyObject *object, PyObject *Py_UNUSED(nothing))
{
    Notifier *self = (Notifier *)object;
    if (self->readers != NULL && self->c.fd >= 0)
        close(self->c.fd);
    self->c.fd = -1;
    Py_RETURN_NONE;
}

static void notifier_free(PyObject *object)
{
    Notifier *self = (Notifier *)object;
    PyTypeObject *type = Py_TYPE(object);
    PyObject_ClearWeakRefs(object);
    if (self->readers != NULL)
        shmgen_notifier_close(&self->c);
    Py_XDECREF(self->readers);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(object);
    Py_DECREF(type);
}

static PyObject *can_wait_for_many(PyObject *Py_UNUSED(module), PyObject *Py_UNUSED(nothing))
{
    return PyBool_FromLong(shmgen_can_wait_for_many());
}

/* --- the module --------------------------------------------------------------------------------------------- */

#define MEMBERS_OF_BOTH                                                                                                \
    {"__weaklistoffset__", T_PYSSIZET, offsetof(End, weak), READONLY, NULL},                                           \
        {"lock_misses", T_UINT, offsetof(End, link.misses), READONLY, NULL},                                           \
        {"reopen_count", T_UINT, offsetof(End, link.reopen_count), READONLY, NULL}

#define METHODS_OF_BOTH                                                                                                \
    {"step", end_step, METH_NOARGS, NULL}, {"load", end_load, METH_O, NULL},                                           \
        {"is_claimed", end_is_claimed, METH_NOARGS, NULL},                                                             \
        {"close", end_close, METH_NOARGS, NULL}, {"close_in_child", end_close_in_child, METH_NOARGS, NULL}

static PyMemberDef writer_members[] = {
    MEMBERS_OF_BOTH,
    {"sequence", T_UINT, offsetof(End, p.sequence), 0, NULL},
    {"predecessor_may_be_alive", T_UINT, offsetof(End, p.new_turn), 0, NULL},
    {"truncations", T_ULONGLONG, offsetof(End, truncations), READONLY, NULL},
    {NULL, 0, 0, 0, NULL},
};

static PyMethodDef writer_methods[] = {
    METHODS_OF_BOTH,
    {"publish", (PyCFunction)(void (*)(void))writer_publish, METH_FASTCALL, NULL},
    {"heartbeat", writer_heartbeat, METH_NOARGS, NULL},
    {"check_claim", writer_check_claim, METH_NOARGS, NULL},
    {NULL, NULL, 0, NULL},
};

static PyMemberDef reader_members[] = {
    MEMBERS_OF_BOTH,
    {"sequence", T_UINT, offsetof(End, s.sequence), READONLY, NULL},
    {"file", T_INT, offsetof(End, link.file), READONLY, NULL},
    {"last", T_UINT, offsetof(End, s.last), 0, NULL},
    {"beat", T_UINT, offsetof(End, s.beat), READONLY, NULL}, /* the heartbeat at the time of opening */
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
    {"check", reader_check, METH_NOARGS, NULL},
    {"skip", reader_skip, METH_NOARGS, NULL},
    {"newest", reader_newest, METH_NOARGS, NULL},
    {"borrow", reader_borrow, METH_NOARGS, NULL},
    {"give_back", reader_give_back, METH_NOARGS, NULL},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot writer_slots[] = {
    {Py_tp_new, (void *)writer_new},
    {Py_tp_members, writer_members},
    {Py_tp_methods, writer_methods},
    {Py_tp_dealloc, (void *)end_free},
    {0, NULL},
};

static PyType_Slot reader_slots[] = {
    {Py_tp_new, (void *)reader_new},
    {Py_tp_members, reader_members},
    {Py_tp_methods, reader_methods},
    {Py_tp_dealloc, (void *)end_free},
    {0, NULL},
};

static PyMemberDef notifier_members[] = {
    {"__weaklistoffset__", T_PYSSIZET, offsetof(Notifier, weak), READONLY, NULL},
    {NULL, 0, 0, 0, NULL},
};

static PyMethodDef notifier_methods[] = {
    {"add", notifier_add, METH_O, NULL},
    {"remove", notifier_remove, METH_O, NULL},
    {"ready", notifier_ready, METH_NOARGS, NULL},
    {"fileno", notifier_fileno, METH_NOARGS, NULL},
    {"close", notifier_close, METH_NOARGS, NULL},
    {"close_in_child", notifier_close_in_child, METH_NOARGS, NULL},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot notifier_slots[] = {
    {Py_tp_init, (void *)notifier_init},
    {Py_tp_members, notifier_members},
    {Py_tp_methods, notifier_methods},
    {Py_tp_dealloc, (void *)notifier_free},
    {0, NULL},
};

static PyType_Spec writer_type = {"shmgen._core.Writer", (int)sizeof(End), 0, Py_TPFLAGS_DEFAULT, writer_slots};
static PyType_Spec reader_type = {"shmgen._core.Reader", (int)sizeof(End), 0, Py_TPFLAGS_DEFAULT, reader_slots};
static PyType_Spec notifier_type = {
    "shmgen._core.Notifier", (int)sizeof(Notifier), 0, Py_TPFLAGS_DEFAULT, notifier_slots};

static int fill(PyObject *module)
{
    PyType_Spec *const types[] = {&writer_type, &reader_type, &notifier_type, &table_type};
    for (size_t index = 0; index < sizeof types / sizeof types[0]; index++) {
        PyObject *type = PyType_FromSpec(types[index]);
        const bool is_added = type != NULL && PyModule_AddType(module, (PyTypeObject *)type) == 0;
        Py_XDECREF(type);
        if (!is_added)
            return -1;
    }
    return PyModule_AddIntConstant(module, "ABI", SHMGEN_ABI);
}

static PyMethodDef functions[] = {
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
