/* The compiled law as a Python module: entries of law.o for arrays; `rows` and
   `operational_space` release the GIL.

   Limited API: one file serves CPython 3.11 and later, with NumPy 2.0 and later. Arrays must be
   contiguous and of the types that the law is compiled for; anything else is a TypeError, upon which
   the controller converts. NumPy's own interface finds an address in 5 ns, the buffer protocol with
   its format in 30.
   LAW is the hash of the sources that law.o was made from. */

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030b0000
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define NPY_TARGET_VERSION NPY_2_0_API_VERSION
#include <Python.h>
#include <numpy/arrayobject.h>
#include <stdint.h>

#define GIVEN 9 /* arrays of a tick */

typedef uintptr_t A;
int32_t osc_law_rows(int64_t *, void **, A, int64_t, A, A);
int32_t osc_law_terms(int64_t *, void **, A, A, A, A, A);
int32_t osc_law_prepare(int64_t *, void **, A, int64_t);
int32_t osc_law_finish(int64_t *, void **, A, int64_t);
int32_t osc_law_fill(int64_t *, void **, A, int64_t, int64_t, A);
int32_t osc_law_settle(int64_t *, void **, A, int64_t, int64_t, A);

/* The address of an array of bytes or float64 with its shape; 0 with an exception set. */
static A take(PyObject *object, int type, int dimensions, int writable, const npy_intp **shape)
{
    PyArrayObject *array = (PyArrayObject *)object;
    if (!PyArray_Check(object) || PyArray_TYPE(array) != type || PyArray_NDIM(array) != dimensions ||
        !PyArray_ISCARRAY_RO(array) || (writable && !PyArray_ISWRITEABLE(array))) {
        PyErr_Format(PyExc_TypeError, "expected a contiguous array of %s with %d dimensions",
                     type == NPY_DOUBLE ? "float64" : "uint8", dimensions);
        return 0;
    }
    *shape = PyArray_DIMS(array);
    return (A)PyArray_DATA(array);
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
    static const int dimensions[] = {1, 1, 2, 2, 1, 1, 1, 2, 1};
    static const int columns[] = {0, 0, 6, 4, 0, 0, 0, 28, 0};
    const npy_intp *shape;
    A raw, at[GIVEN];
    int64_t sizes[GIVEN], result = 0;
    if (!given(count, 3))
        return NULL;
    long long job = PyLong_AsLongLong(args[1]);
    if (job == -1 && PyErr_Occurred())
        return NULL;
    raw = take(args[0], NPY_UBYTE, 1, 1, &shape);
    if (!raw || !given(PyTuple_Check(args[2]) ? PyTuple_Size(args[2]) : 1, GIVEN))
        return NULL;
    for (int i = 0; i < GIVEN; i++) {
        at[i] = take(PyTuple_GetItem(args[2], i), NPY_DOUBLE, dimensions[i], 0, &shape);
        if (!at[i])
            return NULL;
        sizes[i] = columns[i] && shape[1] != columns[i] ? -1 : shape[0];
    }
    Py_BEGIN_ALLOW_THREADS
    osc_law_rows(&result, NULL, raw, job, (A)at, (A)sizes);
    Py_END_ALLOW_THREADS
    return PyLong_FromLongLong(result);
}

static PyObject *operational_space(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    static const int dimensions[] = {1, 1, 1, 2};
    A at[4];
    const npy_intp *shape;
    int64_t sizes[4], result = 0;
    if (!given(count, 4))
        return NULL;
    for (int i = 0; i < 4; i++) {
        at[i] = take(args[i], i == 0 ? NPY_UBYTE : NPY_DOUBLE, dimensions[i], i == 0 || i == 3,
                     &shape);
        if (!at[i])
            return NULL;
        sizes[i] = shape[0];
    }
    sizes[0] = shape[1];
    Py_BEGIN_ALLOW_THREADS
    osc_law_terms(&result, NULL, at[0], at[1], at[2], at[3], (A)sizes);
    Py_END_ALLOW_THREADS
    return PyLong_FromLongLong(result);
}

typedef int32_t (*Solves)(int64_t *, void **, A, int64_t);
typedef int32_t (*Moves)(int64_t *, void **, A, int64_t, int64_t, A);

static PyObject *solve(PyObject *const *args, Py_ssize_t count, Solves part)
{
    const npy_intp *shape;
    int64_t result = 0;
    if (!given(count, 2))
        return NULL;
    long long slack = PyLong_AsLongLong(args[1]);
    A program = PyErr_Occurred() ? 0 : take(args[0], NPY_UBYTE, 1, 1, &shape);
    if (!program)
        return NULL;
    part(&result, NULL, program, slack);
    return PyBool_FromLong(result != 0);
}

static PyObject *move(PyObject *const *args, Py_ssize_t count, Moves part)
{
    const npy_intp *shape;
    int64_t result = 0;
    if (!given(count, 4))
        return NULL;
    long long at = PyLong_AsLongLong(args[1]);
    long long row = PyErr_Occurred() ? 0 : PyLong_AsLongLong(args[2]);
    A raw = PyErr_Occurred() ? 0 : take(args[0], NPY_UBYTE, 1, 1, &shape);
    A program = raw ? take(args[3], NPY_UBYTE, 1, 1, &shape) : 0;
    if (!program)
        return NULL;
    part(&result, NULL, raw, at, row, program);
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
    import_array();
    PyObject *made = PyModule_Create(&module);
    if (made && PyModule_AddStringConstant(made, "LAW", LAW) < 0) {
        Py_DECREF(made);
        return NULL;
    }
    return made;
}
