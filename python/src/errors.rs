//! Errors and panics of the library as Python exceptions of `cutwater.errors`.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

use cutwater::Error;
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Runs work of the library without the GIL. A panic of the library becomes an `InternalError`.
pub(crate) fn guarded<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T, Error> + Send) -> PyResult<T> {
    match py.detach(|| catch_unwind(AssertUnwindSafe(work))) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(error)) => Err(exception(py, &error)),
        Err(panic) => Err(internal(py, &message(&*panic))),
    }
}

fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("no message").to_owned()
}

/// An `InternalError`.
pub(crate) fn internal(py: Python<'_>, problem: &str) -> PyErr {
    let fields = PyDict::new(py);
    let cure = "this is a bug of cutwater: report it with the scene, and start a new simulation";
    let built = (|| {
        fields.set_item("problem", problem)?;
        fields.set_item("cure", cure)?;
        fields.set_item("exit_code", 4)?;
        new(py, "InternalError", &format!("{problem}\n  cure: {cure}"), &fields)
    })();
    built.unwrap_or_else(|error| error)
}

/// The exception of an error.
pub(crate) fn exception(py: Python<'_>, error: &Error) -> PyErr {
    convert(py, error).unwrap_or_else(|error| error)
}

fn convert(py: Python<'_>, error: &Error) -> PyResult<PyErr> {
    let fields = PyDict::new(py);
    fields.set_item("exit_code", error.exit_code())?;
    let class = match error {
        Error::Scene { file, line, key, problem, cure } => {
            fields.set_item("file", file)?;
            fields.set_item("line", line)?;
            fields.set_item("key", key)?;
            fields.set_item("problem", problem)?;
            fields.set_item("cure", cure)?;
            "SceneError"
        }
        Error::Input { what, problem, cure } => {
            fields.set_item("what", what)?;
            fields.set_item("problem", problem)?;
            fields.set_item("cure", cure)?;
            "InputError"
        }
        Error::Output { path, problem, cure } => {
            fields.set_item("file", path)?;
            fields.set_item("problem", problem)?;
            fields.set_item("cure", *cure)?;
            "OutputError"
        }
        Error::Adapter { problem, cure } => {
            fields.set_item("problem", problem)?;
            fields.set_item("cure", cure)?;
            "AdapterError"
        }
        Error::Limit { what, cure, .. } => {
            fields.set_item("what", what)?;
            fields.set_item("cure", cure)?;
            "LimitError"
        }
        Error::Memory { cure, .. } => {
            fields.set_item("cure", cure)?;
            "HostMemoryError"
        }
        Error::Stage { stage, step, problem } => {
            fields.set_item("stage", *stage)?;
            fields.set_item("step", step)?;
            fields.set_item("problem", problem)?;
            "StageError"
        }
        Error::Gpu { problem, .. } | Error::Shader { problem, .. } => {
            fields.set_item("problem", problem)?;
            "DeviceError"
        }
        Error::Check(problem) => {
            fields.set_item("problem", problem)?;
            "CheckError"
        }
        Error::Interrupted => return Ok(PyKeyboardInterrupt::new_err("")),
        _ => "CutwaterError",
    };
    new(py, class, &error.to_string(), &fields)
}

fn new(py: Python<'_>, class: &str, text: &str, fields: &Bound<'_, PyDict>) -> PyResult<PyErr> {
    let module = py.import("cutwater.errors")?;
    let exception = module.getattr("exception")?.call((class, text), Some(fields))?;
    Ok(PyErr::from_value(exception))
}

/// Panics where the library would, for the tests.
#[pyfunction]
pub(crate) fn panic(py: Python<'_>) -> PyResult<()> {
    guarded(py, || panic!("requested by a test"))
}
