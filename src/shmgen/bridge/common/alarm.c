/* Starts a timer when a signal arrives, even if no thread can run Python.

Python runs signal handlers in the main thread, which needs the GIL. If a library blocks with the GIL held, Python's
handlers never run. The handler in this file runs at once and calls alarm(2). If nothing cancels the alarm, the kernel
ends the process with SIGALRM. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <errno.h>
#include <signal.h>
#include <unistd.h>

static struct sigaction chained[NSIG];
static unsigned int limit;

static void start_timer(int number, siginfo_t *information, void *context)
{
    int saved = errno;
    alarm(limit);
    if (chained[number].sa_flags & SA_SIGINFO)
        chained[number].sa_sigaction(number, information, context);
    else if (chained[number].sa_handler != SIG_DFL && chained[number].sa_handler != SIG_IGN)
        chained[number].sa_handler(number);
    errno = saved;
}

static PyObject *start_at(PyObject *module, PyObject *arguments)
{
    int number;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "iI", &number, &limit))
        return NULL;
    struct sigaction ours = {.sa_sigaction = start_timer, .sa_flags = SA_SIGINFO}, before;
    if (number < 1 || number >= NSIG || sigaction(number, &ours, &before) < 0)
        return PyErr_Format(PyExc_ValueError, "%d is not the number of a signal", number);
    if (before.sa_sigaction != start_timer)
        chained[number] = before;
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {
    {"start_at", start_at, METH_VARARGS, "start_at(number, seconds): end the process if it outlives a signal so long."},
    {NULL, NULL, 0, NULL},
};
static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_alarm", NULL, -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__alarm(void)
{
    return PyModule_Create(&definition);
}
