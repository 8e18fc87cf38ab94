//! Arrays for numpy: views of a frame, which owns the memory, and arrays that own theirs. Both are read-only.

use numpy::ndarray::{Array, ArrayView, IxDyn};
use numpy::{Element, IntoPyArray, PyArrayDyn, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyAny;

use crate::frame::Frame;

/// A view of values of a frame in C order, without a copy.
pub(crate) fn view<'py, T: Element>(
    frame: &Bound<'py, Frame>,
    values: impl FnOnce(&Frame) -> &[T],
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    let values = values(frame.get());
    let view = ArrayView::from_shape(IxDyn(shape), values).map_err(mismatch)?;
    let owner = frame.clone().into_any();
    // SAFETY: the values belong to the frame, which is frozen and has no interior mutability, so they neither move nor change. The array
    // holds a reference to it and is made read-only before anyone sees it.
    #[expect(unsafe_code, reason = "the only way to lend memory to numpy")]
    let array = unsafe { PyArrayDyn::borrow_from_array(&view, owner) };
    read_only(array.into_any())
}

/// An array that owns its values, in C order.
pub(crate) fn owned<'py, T: Element>(py: Python<'py>, values: Vec<T>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    let array = Array::from_shape_vec(IxDyn(shape), values).map_err(mismatch)?;
    read_only(array.into_pyarray(py).into_any())
}

/// An array of N numbers a row that owns its values.
pub(crate) fn rows<'py, T: Element, const N: usize>(
    py: Python<'py>,
    values: Vec<[T; N]>,
) -> PyResult<Bound<'py, PyAny>> {
    let n = values.len();
    owned(py, values.into_flattened(), &[n, N])
}

fn read_only(array: Bound<'_, PyAny>) -> PyResult<Bound<'_, PyAny>> {
    array.getattr("flags")?.setattr("writeable", false)?;
    Ok(array)
}

fn mismatch(problem: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(problem.to_string())
}

/// Numbers of a float64 array in C order.
pub(crate) fn numbers(array: &Bound<'_, PyArrayDyn<f64>>) -> PyResult<Vec<f64>> {
    let array = array.try_readonly().map_err(mismatch)?;
    Ok(array.as_array().iter().copied().collect())
}
