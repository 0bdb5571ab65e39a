/* The straight way of publish() and read() in one call each: free lock, topic still ours, sample whole. Wherever
 * anything else is met nothing has been done, and Python goes its own way (publisher.py, subscriber.py), which knows
 * how to wait, to heal and what to raise. So no call here waits but the two that doze, and none runs Python code inside
 * the lock.
 *
 * Over the same header as generated C (templates/c), in CPython's limited API: one binary for 3.10 and all later.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <structmember.h>

#include <math.h>
#include <sys/syscall.h>

#include "codec.h"
#include "shmgen_subscriber.h"

/* One step of taking numbers out of an object: the attribute `name` of object number `from` of those met so far (0 is the
 * message), which is the next object, a number, or an array of `most` numbers: `code` is struct's, `at` the offset in
 * scratch. */
typedef struct Step {
    PyObject *name;
    size_t at;
    size_t most;     /* 0: no array */
    size_t count_at; /* offset of the count of one with a bound, 0: all are there */
    unsigned int from;
    char code; /* 0: an object */
} Step;

#define MOST_OBJECTS 32

/* An array that is copied straight into its slot: room in scratch, which it is copied in place of, and where to. */
typedef struct Late {
    size_t offset;
    size_t room;
    PyObject *bytes; /* a memoryview, borrowed of the list of all */
    PyObject *where; /* a slice of the region's map; NULL: no bytes */
} Late;

#define MOST_LATE 16

/* base == NULL: not connected. What it points at, and the objects, are kept by the object in Python. */
typedef struct Writer {
    PyObject_HEAD
    shmgen_link end;
    unsigned char *scratch; /* header of a slot, then the message */
    Step *steps;            /* NULL: Python encodes */
    Py_ssize_t count;
    PyObject *map;
    PyObject *kind;         /* the message type */
    PyObject *message;      /* one message of it, an array's, that lies in scratch; NULL: too long for that */
    sem_t *event;
    size_t size;           /* bytes of a message */
    unsigned int sequence; /* number of the newest sample */
    unsigned int beat;
    char direct; /* 1: connected */
    char plain;  /* 1: and there are steps */
} Writer;

typedef struct Reader {
    PyObject_HEAD
    shmgen_link end;
    PyObject *stamp; /* of the newest sample read, NULL: none yet */
    unsigned long long event; /* address of the sem_t, which stays mapped also when it is closed; 0: there is none */
    size_t size;
    unsigned long long missed;
    unsigned int last;
    int is_long; /* 1: samples become a bytearray, in which a message can lie */
} Reader;

static bool enter(const shmgen_link *end)
{
    if (sem_trywait(end->lock) != 0)
        return false;
    shmgen_store(end, SHMGEN_AT(lock_count), shmgen_load(end, SHMGEN_AT(lock_count)) + 1);
    shmgen_store(end, SHMGEN_AT(lock_holder), end->pid);
    return true;
}

static bool steps_of(Writer *self, PyObject *plan)
{
    const Py_ssize_t count = PyTuple_Size(plan);
    Step *steps = count > 0 ? PyMem_Calloc((size_t)count, sizeof(Step)) : NULL;
    if (count <= 0)
        return count == 0;
    self->steps = steps;
    for (Py_ssize_t number = 0; steps != NULL && number < count; number++) {
        unsigned long long at, most, count_at;
        PyObject *name;
        int code;
        if (!PyArg_ParseTuple(PyTuple_GetItem(plan, number), "UiKIKK", &name, &code, &at, &steps[number].from, &most,
                              &count_at))
            return false;
        Py_INCREF(name);
        PyUnicode_InternInPlace(&name);
        steps[number].name = name;
        steps[number].code = (char)code;
        steps[number].at = (size_t)at;
        steps[number].most = (size_t)most;
        steps[number].count_at = (size_t)count_at;
        self->count = number + 1;
    }
    if (steps == NULL)
        PyErr_NoMemory();
    return steps != NULL;
}

static PyObject *writer_connect(PyObject *object, PyObject *arguments)
{
    Writer *self = (Writer *)object;
    unsigned long long base, lock, event, scratch, size;
    unsigned int slots, slot_size, pid;
    PyObject *plan, *map, *kind, *message;
    if (!PyArg_ParseTuple(arguments, "KKKKKIIIO!OOO", &base, &lock, &event, &scratch, &size, &slots, &slot_size, &pid,
                          &PyTuple_Type, &plan, &map, &kind, &message))
        return NULL;
    if (self->steps != NULL || !steps_of(self, plan))
        return PyErr_Occurred() != NULL ? NULL : PyErr_Format(PyExc_RuntimeError, "connected twice");
    self->end.lock = (sem_t *)(uintptr_t)lock;
    self->end.slots = slots;
    self->end.slot_size = slot_size;
    self->end.pid = pid;
    self->map = map;
    self->kind = kind;
    self->message = message != Py_None ? message : NULL;
    self->event = (sem_t *)(uintptr_t)event;
    self->scratch = (unsigned char *)(uintptr_t)scratch;
    self->size = (size_t)size;
    self->end.base = (unsigned char *)(uintptr_t)base;
    self->direct = 1;
    self->plain = self->steps != NULL;
    Py_RETURN_NONE;
}

static PyObject *writer_disconnect(PyObject *object, PyObject *nothing)
{
    Writer *self = (Writer *)object;
    (void)nothing;
    self->end.base = NULL;
    self->direct = self->plain = 0;
    Py_RETURN_NONE;
}

/* Copies scratch, and late arrays in their room. False: an exception is set. */
static bool copy(const Writer *self, unsigned char *payload, const Late *late, size_t count)
{
    const unsigned char *scratch = self->scratch + SHMGEN_SLOT_HEADER;
    size_t done = 0;
    for (const Late *one = late; one < late + count; one++) {
        if (one->offset > done)
            memcpy(payload + done, scratch + done, one->offset - done);
        if (one->where != NULL && PyObject_SetItem(self->map, one->where, one->bytes) != 0)
            return false;
        done = one->offset + one->room;
    }
    if (done < self->size)
        memcpy(payload + done, scratch + done, self->size - done);
    return true;
}

/* Publishes what lies in scratch, and late arrays. False: nothing was done, or an exception is set. */
static bool publish(Writer *self, const Late *late, size_t count)
{
    shmgen_link *end = &self->end;
    const bool locks = end->lock != NULL;
    uint32_t number;
    uint64_t stamp;
    size_t slot;
    bool ours;
    if (end->base == NULL || (locks && !enter(end)))
        return false;
    if (shmgen_load(end, SHMGEN_AT(writer)) != end->pid) {
        if (locks)
            shmgen_leave(end);
        return false;
    }
    number = shmgen_after(end, self->sequence, 1);
    slot = shmgen_slot_of(end, number);
    stamp = shmgen_wall();
    shmgen_store(end, SHMGEN_AT(heartbeat), self->beat + 1);
    shmgen_store(end, SHMGEN_AT(begun), number);
    if (self->size < SHMGEN_STREAMED)
        __atomic_thread_fence(__ATOMIC_RELEASE);
    else
        __atomic_thread_fence(__ATOMIC_SEQ_CST);
    memcpy(end->base + slot + offsetof(shmgen_slot, stamp_ns), &stamp, sizeof stamp);
    memcpy(end->base + slot + offsetof(shmgen_slot, number), &number, sizeof number);
    if (!copy(self, end->base + slot + SHMGEN_SLOT_HEADER, late, count)) {
        if (locks)
            shmgen_leave(end);
        return false;
    }
    ours = shmgen_load(end, SHMGEN_AT(writer)) == end->pid;
    if (ours) {
        self->sequence = number;
        self->beat++;
        shmgen_store(end, SHMGEN_AT(completed), number);
    } else {
        shmgen_store(end, slot + offsetof(shmgen_slot, number), 0); /* what lies there may be of two writers */
    }
    if (locks)
        shmgen_leave(end);
    shmgen_fence(locks);
    if (ours && shmgen_load(end, SHMGEN_AT(armed)) != 0) {
        shmgen_store(end, SHMGEN_AT(armed), 0);
        if (self->event != NULL)
            shmgen_post(self->event);
    }
    return ours;
}

static PyObject *writer_straight(PyObject *object, PyObject *nothing)
{
    (void)nothing;
    return PyBool_FromLong(publish((Writer *)object, NULL, 0));
}

static size_t next_slot(const Writer *self)
{
    return shmgen_slot_of(&self->end, shmgen_after(&self->end, self->sequence, 1));
}

static size_t number_of(PyObject *tuple, Py_ssize_t index)
{
    return PyLong_AsSize_t(PyTuple_GetItem(tuple, index));
}

/* Fills `one` of (offset in scratch, room, bytes). False: an exception is set, or it is none to be copied. All that may
 * run code of anybody's is done here, before the lock. */
static bool late_of(const Writer *self, PyObject *item, size_t slot, Late *one)
{
    PyObject *bytes = PyTuple_GetItem(item, 2), *length, *from, *to;
    size_t count;
    one->where = NULL;
    if (bytes == NULL)
        return false;
    one->bytes = bytes;
    one->offset = number_of(item, 0) - SHMGEN_SLOT_HEADER;
    one->room = number_of(item, 1);
    length = PyObject_GetAttrString(bytes, "nbytes");
    if (length == NULL)
        return false;
    count = PyLong_AsSize_t(length);
    Py_DECREF(length);
    if (PyErr_Occurred() != NULL || one->room == 0 || one->offset > self->size ||
        one->room > self->size - one->offset || count > one->room)
        return false;
    if (count == 0)
        return true;
    from = PyLong_FromSize_t(slot + SHMGEN_SLOT_HEADER + one->offset);
    to = PyLong_FromSize_t(slot + SHMGEN_SLOT_HEADER + one->offset + count);
    if (from != NULL && to != NULL)
        one->where = PySlice_New(from, to, NULL);
    Py_XDECREF(from);
    Py_XDECREF(to);
    return one->where != NULL;
}

/* The same with arrays that were left out of scratch. False: nothing was done. */
static PyObject *writer_with_late(PyObject *object, PyObject *list)
{
    Writer *self = (Writer *)object;
    const Py_ssize_t count = PyList_Size(list);
    size_t known = 0;
    Late late[MOST_LATE];
    bool done = false;
    if (count < 0)
        return NULL;
    if (self->end.base != NULL && count <= MOST_LATE) {
        const size_t slot = next_slot(self);
        while (known < (size_t)count && late_of(self, PyList_GetItem(list, (Py_ssize_t)known), slot, &late[known]))
            known++;
        done = known == (size_t)count && next_slot(self) == slot && publish(self, late, known);
        while (known > 0)
            Py_XDECREF(late[--known].where);
    }
    return PyErr_Occurred() != NULL ? NULL : PyBool_FromLong(done);
}

static size_t size_of(char code)
{
    return strchr("qQd", code) != NULL ? 8 : strchr("iIf", code) != NULL ? 4 : strchr("hH", code) != NULL ? 2 : 1;
}

/* Writes a number of exactly the kind that needs no second look; false: Python looks at it, and at all others. */
static bool store(unsigned char *into, char code, PyObject *value)
{
    if (code == 'd' || code == 'f') {
        double number;
        if (PyFloat_CheckExact(value))
            number = PyFloat_AsDouble(value);
        else if (!PyLong_CheckExact(value) || ((number = PyLong_AsDouble(value)) == -1.0 && PyErr_Occurred() != NULL))
            return false;
        if (code == 'd') {
            memcpy(into, &number, sizeof number);
        } else {
            float single = (float)number;
            if (isinf(single) && !isinf(number))
                return false;
            memcpy(into, &single, sizeof single);
        }
        return true;
    }
    if (code == '?') {
        if (value != Py_True && value != Py_False)
            return false;
        *into = value == Py_True;
        return true;
    }
    if (!PyLong_CheckExact(value))
        return false;
    if (code == 'Q') {
        uint64_t number = PyLong_AsUnsignedLongLong(value);
        memcpy(into, &number, sizeof number);
        return number != UINT64_MAX || PyErr_Occurred() == NULL;
    } else {
        int overflow = 0;
        int64_t number = PyLong_AsLongLongAndOverflow(value, &overflow);
        if (overflow != 0)
            return false;
#define KEEP(type)                              \
    {                                           \
        type kept = (type)number;               \
        memcpy(into, &kept, sizeof kept);       \
        return (int64_t)kept == number;         \
    }
        switch (code) {
        case 'b': KEEP(int8_t)
        case 'B': KEEP(uint8_t)
        case 'h': KEEP(int16_t)
        case 'H': KEEP(uint16_t)
        case 'i': KEEP(int32_t)
        case 'I': KEEP(uint32_t)
        case 'q': KEEP(int64_t)
        default: return false;
        }
#undef KEEP
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

/* A number that is an attribute; -1 and an exception: it is none. */
static Py_ssize_t number_at(PyObject *object, const char *name)
{
    PyObject *value = PyObject_GetAttrString(object, name);
    const Py_ssize_t number = value != NULL ? PyLong_AsSsize_t(value) : -1;
    Py_XDECREF(value);
    return number;
}

/* A copy of a buffer's bytes (array.array, numpy's), in order; NULL: it has none, or they are no such numbers. */
static PyObject *bytes_of(PyObject *value, char code)
{
    PyObject *view = PyMemoryView_FromObject(value), *bytes = NULL;
    PyObject *format = view != NULL ? PyObject_GetAttrString(view, "format") : NULL;
    const char *text = format != NULL ? PyUnicode_AsUTF8AndSize(format, NULL) : NULL;
    if (text != NULL) {
        text += strspn(text, "@=<");
        if (*text != 0 && text[1] == 0 && family(*text) == family(code) &&
            number_at(view, "itemsize") == (Py_ssize_t)size_of(code) && number_at(view, "ndim") > 0)
            bytes = PyBytes_FromObject(view);
    }
    Py_XDECREF(format);
    Py_XDECREF(view);
    return bytes;
}

static bool counted(unsigned char *scratch, const Step *step, Py_ssize_t length)
{
    const uint32_t count = (uint32_t)length;
    if (length < 0 || (size_t)length > step->most || (step->count_at == 0 && (size_t)length < step->most))
        return false;
    if (step->count_at != 0)
        memcpy(scratch + step->count_at, &count, sizeof count);
    return true;
}

/* The same for an array: a list or a tuple number by number, in which no code of anybody's runs; of others the bytes. */
static bool store_all(unsigned char *scratch, const Step *step, PyObject *value)
{
    const size_t size = size_of(step->code);
    unsigned char *into = scratch + step->at;
    const bool is_list = PyList_CheckExact(value);
    PyObject *bytes;
    bool taken;
    if (is_list || PyTuple_CheckExact(value)) {
        const Py_ssize_t length = is_list ? PyList_Size(value) : PyTuple_Size(value);
        taken = counted(scratch, step, length);
        for (Py_ssize_t index = 0; taken && index < length; index++, into += size)
            taken = store(into, step->code, is_list ? PyList_GetItem(value, index) : PyTuple_GetItem(value, index));
        return taken;
    }
    if (PyBytes_CheckExact(value) && step->code == 'B') {
        bytes = value;
        Py_INCREF(bytes);
    } else {
        bytes = bytes_of(value, step->code);
    }
    taken = bytes != NULL && counted(scratch, step, PyBytes_Size(bytes) / (Py_ssize_t)size);
    if (taken)
        memcpy(into, PyBytes_AsString(bytes), (size_t)PyBytes_Size(bytes));
    Py_XDECREF(bytes);
    return taken;
}

/* Takes a message of the message type, or the numbers out of any object, and publishes it. False: nothing was done. */
static PyObject *writer_at_once(PyObject *object, PyObject *message)
{
    Writer *self = (Writer *)object;
    PyObject *met[MOST_OBJECTS];
    unsigned int known = 1;
    bool taken = self->plain != 0;
    if ((PyObject *)Py_TYPE(message) == self->kind) {
        if (self->message == NULL || self->end.base == NULL)
            Py_RETURN_FALSE;
        if (PySequence_SetItem(self->message, 0, message) != 0)
            return NULL;
        return PyBool_FromLong(publish(self, NULL, 0));
    }
    met[0] = message;
    for (Py_ssize_t number = 0; taken && number < self->count; number++) {
        const Step *step = &self->steps[number];
        PyObject *value = PyObject_GetAttr(met[step->from], step->name);
        if (value == NULL) {
            taken = false;
        } else if (step->code == 0) {
            met[known++] = value;
        } else {
            taken = step->most != 0 ? store_all(self->scratch, step, value)
                                    : store(self->scratch + step->at, step->code, value);
            Py_DECREF(value);
        }
    }
    while (known > 1)
        Py_DECREF(met[--known]);
    if (PyErr_Occurred() != NULL) {
        if (!PyErr_ExceptionMatches(PyExc_Exception))
            return NULL;
        PyErr_Clear(); /* Python meets it once more, and says where */
    }
    return PyBool_FromLong(taken && publish(self, NULL, 0));
}

static PyObject *reader_connect(PyObject *object, PyObject *arguments)
{
    Reader *self = (Reader *)object;
    unsigned long long base, lock, size;
    unsigned int slots, slot_size, pid;
    int is_long;
    if (!PyArg_ParseTuple(arguments, "KKKIIIp", &base, &lock, &size, &slots, &slot_size, &pid, &is_long))
        return NULL;
    self->end.lock = (sem_t *)(uintptr_t)lock;
    self->end.slots = slots;
    self->end.slot_size = slot_size;
    self->end.pid = pid;
    self->size = (size_t)size;
    self->is_long = is_long;
    self->end.base = (unsigned char *)(uintptr_t)base;
    Py_RETURN_NONE;
}

static PyObject *reader_disconnect(PyObject *object, PyObject *nothing)
{
    (void)nothing;
    ((Reader *)object)->end.base = NULL;
    Py_RETURN_NONE;
}

/* The payload of a sample if it is whole, which then counts as read; None: nothing was done. */
static PyObject *reader_straight(PyObject *object, PyObject *asked)
{
    Reader *self = (Reader *)object;
    shmgen_link *end = &self->end;
    const bool locks = end->lock != NULL;
    const uint32_t number = (uint32_t)PyLong_AsUnsignedLong(asked);
    const size_t slot = shmgen_slot_of(end, number);
    PyObject *data, *taken, *former;
    uint64_t stamp = 0;
    uint32_t skipped;
    bool whole;
    if (PyErr_Occurred() != NULL)
        return NULL;
    if (end->base == NULL || number == 0)
        Py_RETURN_NONE;
    data = self->is_long ? PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)self->size)
                         : PyBytes_FromStringAndSize(NULL, (Py_ssize_t)self->size);
    if (data == NULL)
        return NULL;
    if (locks && !enter(end)) {
        Py_DECREF(data);
        Py_RETURN_NONE;
    }
    whole = shmgen_is_whole(end, number, slot);
    if (whole) {
        memcpy(&stamp, end->base + slot + offsetof(shmgen_slot, stamp_ns), sizeof stamp);
        memcpy(self->is_long ? PyByteArray_AsString(data) : PyBytes_AsString(data), end->base + slot + SHMGEN_SLOT_HEADER,
               self->size);
        __atomic_thread_fence(__ATOMIC_ACQUIRE);
        whole = shmgen_is_whole(end, number, slot);
    }
    if (locks)
        shmgen_leave(end);
    taken = whole ? PyLong_FromUnsignedLongLong(stamp) : NULL;
    if (taken == NULL) {
        Py_DECREF(data);
        if (whole)
            return NULL;
        Py_RETURN_NONE;
    }
    skipped = shmgen_steps(end, self->last, number) - 1;
    if (skipped != 0 && skipped < SHMGEN_RESTART_GAP) {
        self->missed += skipped;
        shmgen_store(end, SHMGEN_AT(missed), shmgen_load(end, SHMGEN_AT(missed)) + skipped);
    }
    self->last = number;
    former = self->stamp;
    self->stamp = taken;
    Py_XDECREF(former);
    return data;
}

#ifdef SHMGEN_HAS_CLOCKWAIT
/* Left set, `armed` would look like another reader's. While the GIL was let go another thread may have closed it. */
static void disarm(const Reader *self, bool came)
{
    if (self->end.base != NULL && (!came || shmgen_load(&self->end, SHMGEN_AT(armed)) != 0))
        shmgen_store(&self->end, SHMGEN_AT(armed), 0);
}

/* True: it was nobody else's, there is an event, and we are to look at `completed` behind a fence, doze, and disarm. */
static bool arm(const Reader *self)
{
    if (self->end.base == NULL || self->event == 0 || shmgen_load(&self->end, SHMGEN_AT(armed)) != 0)
        return false;
    shmgen_store(&self->end, SHMGEN_AT(armed), 1);
    return true;
}

static struct timespec in_ns(int64_t ns)
{
    const int64_t until = shmgen_now() + ns;
    struct timespec time;
    time.tv_sec = (time_t)(until / INT64_C(1000000000));
    time.tv_nsec = (long)(until % INT64_C(1000000000));
    return time;
}
#endif

/* Waits so many ns for the event unless `completed` has left `newest` behind, or a signal comes, whose handler is then
 * Python's to call. False: nothing was done. */
static PyObject *reader_doze(PyObject *object, PyObject *arguments)
{
#ifdef SHMGEN_HAS_CLOCKWAIT
    Reader *self = (Reader *)object;
    unsigned int newest;
    long long ns;
    bool came = false;
    if (!PyArg_ParseTuple(arguments, "LI", &ns, &newest))
        return NULL;
    if (!arm(self))
        Py_RETURN_FALSE;
    shmgen_fence(false);
    if (shmgen_load(&self->end, SHMGEN_AT(completed)) == newest) {
        const struct timespec until = in_ns(ns);
        Py_BEGIN_ALLOW_THREADS
        came = sem_clockwait((sem_t *)(uintptr_t)self->event, CLOCK_MONOTONIC, &until) == 0;
        Py_END_ALLOW_THREADS
    }
    disarm(self, came);
    Py_RETURN_TRUE;
#else
    (void)object;
    (void)arguments;
    Py_RETURN_FALSE;
#endif
}

/* One sleep on many events asks for futex_waitv (Linux 5.16) and for the sem_t of a 64-bit glibc, the same since 2.21:
 * eight bytes, of which the lower four are the value and the upper four count who waits. sem_post() adds one to the
 * value, and wakes one of those who wait for that word if the count is not 0. (sem_clockwait came with 2.30.) */
#if defined(SHMGEN_HAS_CLOCKWAIT) && defined(__LP64__) && __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
#define HAS_MANY 1
#define WAITS (UINT64_C(1) << 32)
#ifndef SYS_futex_waitv
#define SYS_futex_waitv 449
#endif

/* struct futex_waitv of linux/futex.h, which older headers lack. */
typedef struct Wait {
    uint64_t value;
    uint64_t word;
    uint32_t flags;
    uint32_t reserved;
} Wait;
#define SHARED_32 2 /* FUTEX_32 */
#define MOST_WAITS 128

/* Until a post of any, a signal, or the time. False: this kernel, or who guards it, does not do that. */
static bool sleep_on(Reader *const *readers, size_t count, int64_t ns)
{
    const struct timespec until = in_ns(ns);
    Wait waits[MOST_WAITS];
    bool could;
    for (size_t number = 0; number < count; number++) {
        waits[number] = (Wait){0, readers[number]->event, SHARED_32, 0};
        __atomic_fetch_add((uint64_t *)(uintptr_t)readers[number]->event, WAITS, __ATOMIC_SEQ_CST);
    }
    Py_BEGIN_ALLOW_THREADS
    could = syscall(SYS_futex_waitv, waits, (unsigned int)count, 0, &until, CLOCK_MONOTONIC) >= 0 || errno == EAGAIN ||
            errno == EINTR || errno == ETIMEDOUT;
    Py_END_ALLOW_THREADS
    for (size_t number = 0; number < count; number++)
        __atomic_fetch_sub((uint64_t *)(uintptr_t)waits[number].word, WAITS, __ATOMIC_SEQ_CST);
    return could;
}
#endif

/* Dozes as above for all of a tuple of readers at once, so many ns at most, or as many as the second number says where
 * there is one that nobody would wake us for. False: it was no sleep. */
static PyObject *readers_doze(PyObject *type, PyObject *arguments)
{
#ifdef HAS_MANY
    Reader *armed[MOST_WAITS];
    PyObject *readers;
    long long ns, poll;
    size_t count = 0;
    bool slept = false, unread = false;
    Py_ssize_t length;
    if (!PyArg_ParseTuple(arguments, "O!LL", &PyTuple_Type, &readers, &ns, &poll))
        return NULL;
    length = PyTuple_Size(readers);
    for (Py_ssize_t number = 0; number < length; number++)
        if (!PyObject_TypeCheck(PyTuple_GetItem(readers, number), (PyTypeObject *)type))
            return PyErr_Format(PyExc_TypeError, "these are for subscribers");
    for (Py_ssize_t number = 0; number < length; number++) {
        Reader *self = (Reader *)PyTuple_GetItem(readers, number);
        if (count < MOST_WAITS && arm(self))
            armed[count++] = self;
        else if (poll < ns)
            ns = poll;
    }
    shmgen_fence(false);
    for (size_t number = 0; number < count; number++) {
        const uint32_t newest = shmgen_load(&armed[number]->end, SHMGEN_AT(completed));
        unread = unread || (newest != 0 && newest != armed[number]->last);
    }
    if (count != 0 && !unread)
        slept = sleep_on(armed, count, ns);
    for (size_t number = 0; number < count; number++)
        disarm(armed[number], sem_trywait((sem_t *)(uintptr_t)armed[number]->event) == 0);
    return PyBool_FromLong(slept || unread);
#else
    (void)type;
    (void)arguments;
    Py_RETURN_FALSE;
#endif
}

static void object_free(PyObject *object)
{
    PyTypeObject *type = Py_TYPE(object);
    freefunc release = (freefunc)PyType_GetSlot(type, Py_tp_free);
    release(object);
    Py_DECREF(type);
}

static void writer_free(PyObject *object)
{
    Writer *self = (Writer *)object;
    for (Py_ssize_t number = 0; number < self->count; number++)
        Py_DECREF(self->steps[number].name);
    PyMem_Free(self->steps);
    object_free(object);
}

static void reader_free(PyObject *object)
{
    Py_XDECREF(((Reader *)object)->stamp);
    object_free(object);
}

static PyMemberDef writer_members[] = {
    {"_sequence", T_UINT, offsetof(Writer, sequence), 0, NULL},
    {"_heartbeat", T_UINT, offsetof(Writer, beat), 0, NULL},
    {"_direct", T_BOOL, offsetof(Writer, direct), 0, NULL},
    {"_plain", T_BOOL, offsetof(Writer, plain), 0, NULL},
    {NULL, 0, 0, 0, NULL},
};

static PyMethodDef writer_methods[] = {
    {"_connect", writer_connect, METH_VARARGS, NULL},
    {"_disconnect", writer_disconnect, METH_NOARGS, NULL},
    {"_straight", writer_straight, METH_NOARGS, NULL},
    {"_with_late", writer_with_late, METH_O, NULL},
    {"_at_once", writer_at_once, METH_O, NULL},
    {NULL, NULL, 0, NULL},
};

static PyMemberDef reader_members[] = {
    {"_last", T_UINT, offsetof(Reader, last), 0, NULL},
    {"_missed", T_ULONGLONG, offsetof(Reader, missed), 0, NULL},
    {"_stamp", T_OBJECT, offsetof(Reader, stamp), 0, NULL},
    {"_event_at", T_ULONGLONG, offsetof(Reader, event), 0, NULL},
    {NULL, 0, 0, 0, NULL},
};

static PyMethodDef reader_methods[] = {
    {"_connect", reader_connect, METH_VARARGS, NULL},
    {"_disconnect", reader_disconnect, METH_NOARGS, NULL},
    {"_straight", reader_straight, METH_O, NULL},
    {"_doze", reader_doze, METH_VARARGS, NULL},
    {"_doze_all", readers_doze, METH_VARARGS | METH_CLASS, NULL},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot writer_slots[] = {
    {Py_tp_members, writer_members},
    {Py_tp_methods, writer_methods},
    {Py_tp_dealloc, (void *)writer_free},
    {0, NULL},
};

static PyType_Slot reader_slots[] = {
    {Py_tp_members, reader_members},
    {Py_tp_methods, reader_methods},
    {Py_tp_dealloc, (void *)reader_free},
    {0, NULL},
};

static PyType_Spec specifications[] = {
    {"shmgen._core.Writer", (int)sizeof(Writer), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE, writer_slots},
    {"shmgen._core.Reader", (int)sizeof(Reader), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE, reader_slots},
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
    return codec_fill(module) != 0 ? -1 : PyModule_AddIntConstant(module, "ABI", SHMGEN_ABI);
}

/* A full barrier, on every machine. */
static PyObject *fence(PyObject *module, PyObject *nothing)
{
    (void)module;
    (void)nothing;
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    Py_RETURN_NONE;
}

/* Whether _doze_all() of readers can sleep. A kernel that knows the call says that none at all is too few. */
static PyObject *has_many(PyObject *module, PyObject *nothing)
{
    (void)module;
    (void)nothing;
#ifdef HAS_MANY
    return PyBool_FromLong(syscall(SYS_futex_waitv, NULL, 0, 0, NULL, CLOCK_MONOTONIC) != 0 && errno == EINVAL);
#else
    Py_RETURN_FALSE;
#endif
}

static PyMethodDef functions[] = {
    {"fence", fence, METH_NOARGS, NULL},
    {"has_many", has_many, METH_NOARGS, NULL},
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
