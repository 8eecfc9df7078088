/* The compiled law as a Python module: entries of law.o for arrays, the GIL released.

   Limited API: one file serves CPython 3.11 and later. Arrays must be contiguous and of the types
   that the law is compiled for; anything else is a TypeError, upon which the controller converts.
   LAW is the hash of the sources that law.o was made from. */

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030b0000
#include <Python.h>
#include <stdint.h>

#define MOST 9 /* arrays of one call */

typedef uintptr_t A;
int32_t osc_law_many(int64_t *, void **, A, int64_t, A, A, A, A, A, A, A, A, A);
int32_t osc_law_terms(int64_t *, void **, A, A, A, A, A);
int32_t osc_law_prepare(int64_t *, void **, A, int64_t);
int32_t osc_law_finish(int64_t *, void **, A, int64_t);
int32_t osc_law_fill(int64_t *, void **, A, int64_t, int64_t, A);
int32_t osc_law_settle(int64_t *, void **, A, int64_t, int64_t, A);

typedef struct {
    Py_buffer views[MOST];
    int count;
} Arrays;

static void release(Arrays *arrays)
{
    while (arrays->count > 0)
        PyBuffer_Release(&arrays->views[--arrays->count]);
}

/* The address of an array of bytes ('B') or numbers ('d'); 0 with an exception set. */
static A take(Arrays *arrays, PyObject *object, char format, int dimensions, int writable)
{
    Py_buffer *view = &arrays->views[arrays->count];
    int flags = PyBUF_FORMAT | PyBUF_C_CONTIGUOUS | (writable ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(object, view, flags) != 0) {
        PyErr_Clear();
        PyErr_SetString(PyExc_TypeError, "expected a contiguous array");
        return 0;
    }
    arrays->count++;
    const char *found = view->format ? view->format : "B";
    if (found[0] != format || found[1] != 0 || view->ndim != dimensions) {
        PyErr_Format(PyExc_TypeError, "expected an array of '%c' with %d dimensions", format,
                     dimensions);
        return 0;
    }
    return (A)view->buf;
}

/* Rows of a table; −1 where it has other columns. */
static int64_t rows_of(const Py_buffer *view, Py_ssize_t columns)
{
    return view->shape[1] == columns ? view->shape[0] : -1;
}

static int given(Py_ssize_t count, Py_ssize_t expected)
{
    if (count == expected)
        return 1;
    PyErr_Format(PyExc_TypeError, "expected %zd arguments, got %zd", expected, count);
    return 0;
}

static PyObject *rows(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    static const int dimensions[] = {1, 1, 1, 2, 2, 1, 1, 1, 2};
    static const int columns[] = {0, 0, 0, 6, 4, 0, 0, 0, 28};
    Arrays arrays = {.count = 0};
    A at[MOST];
    int64_t sizes[MOST], result = 0;
    if (!given(count, MOST + 1))
        return NULL;
    long long job = PyLong_AsLongLong(args[1]);
    if (job == -1 && PyErr_Occurred())
        return NULL;
    for (int i = 0; i < MOST; i++) {
        at[i] = take(&arrays, args[i == 0 ? 0 : i + 1], i == 0 ? 'B' : 'd', dimensions[i], i == 0);
        if (PyErr_Occurred()) {
            release(&arrays);
            return NULL;
        }
        const Py_buffer *view = &arrays.views[i];
        sizes[i] = columns[i] ? rows_of(view, columns[i]) : view->shape[0];
    }
    Py_BEGIN_ALLOW_THREADS
    osc_law_many(&result, NULL, at[0], job, at[1], at[2], at[3], at[4], at[5], at[6], at[7], at[8],
                 (A)sizes);
    Py_END_ALLOW_THREADS
    release(&arrays);
    return PyLong_FromLongLong(result);
}

static PyObject *operational_space(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    static const int dimensions[] = {1, 1, 1, 2};
    Arrays arrays = {.count = 0};
    A at[4];
    int64_t sizes[4], result = 0;
    if (!given(count, 4))
        return NULL;
    for (int i = 0; i < 4; i++) {
        at[i] = take(&arrays, args[i], i == 0 ? 'B' : 'd', dimensions[i], i == 0 || i == 3);
        if (PyErr_Occurred()) {
            release(&arrays);
            return NULL;
        }
        sizes[i] = arrays.views[i].shape[0];
    }
    sizes[0] = arrays.views[3].shape[1];
    Py_BEGIN_ALLOW_THREADS
    osc_law_terms(&result, NULL, at[0], at[1], at[2], at[3], (A)sizes);
    Py_END_ALLOW_THREADS
    release(&arrays);
    return PyLong_FromLongLong(result);
}

typedef int32_t (*Solves)(int64_t *, void **, A, int64_t);
typedef int32_t (*Moves)(int64_t *, void **, A, int64_t, int64_t, A);

static PyObject *solve(PyObject *const *args, Py_ssize_t count, Solves part)
{
    Arrays arrays = {.count = 0};
    int64_t result = 0;
    if (!given(count, 2))
        return NULL;
    long long slack = PyLong_AsLongLong(args[1]);
    A program = PyErr_Occurred() ? 0 : take(&arrays, args[0], 'B', 1, 1);
    if (program)
        part(&result, NULL, program, slack);
    release(&arrays);
    return PyErr_Occurred() ? NULL : PyBool_FromLong(result != 0);
}

static PyObject *move(PyObject *const *args, Py_ssize_t count, Moves part)
{
    Arrays arrays = {.count = 0};
    int64_t result = 0;
    if (!given(count, 4))
        return NULL;
    long long at = PyLong_AsLongLong(args[1]);
    long long row = PyErr_Occurred() ? 0 : PyLong_AsLongLong(args[2]);
    A raw = PyErr_Occurred() ? 0 : take(&arrays, args[0], 'B', 1, 1);
    A program = raw ? take(&arrays, args[3], 'B', 1, 1) : 0;
    if (program)
        part(&result, NULL, raw, at, row, program);
    release(&arrays);
    if (PyErr_Occurred())
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *prepare(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    return solve(args, count, osc_law_prepare);
}

static PyObject *finish(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    return solve(args, count, osc_law_finish);
}

static PyObject *fill_program(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    return move(args, count, osc_law_fill);
}

static PyObject *settle(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    return move(args, count, osc_law_settle);
}

#define ENTRY(name) {#name, (PyCFunction)(void (*)(void))name, METH_FASTCALL, NULL}

static PyMethodDef methods[] = {
    ENTRY(rows),         ENTRY(operational_space), ENTRY(prepare), ENTRY(finish),
    ENTRY(fill_program), ENTRY(settle),            {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "osc_law", NULL, 0, methods};

PyMODINIT_FUNC PyInit_osc_law(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made && PyModule_AddStringConstant(made, "LAW", LAW) < 0) {
        Py_DECREF(made);
        return NULL;
    }
    return made;
}
