//! Plans, comparisons, whole runs, adapters and the command line.

use std::ffi::OsString;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use cutwater::gpu::{AdapterReport, Gpu};
use cutwater::measure::compare;
use cutwater::sim::{self, Backend, HostMemory, Plan};
use cutwater::step::Runner;
use pyo3::prelude::*;
use serde_json::{Value, json};

use crate::errors::{exception, guarded};
use crate::scene::Scene;
use crate::simulation::{backend_of, choice};

fn adapter_json(adapter: &AdapterReport) -> Value {
    json!({
        "name": adapter.name, "driver": adapter.driver, "api": adapter.backend, "kind": adapter.kind, "f64": adapter.f64,
        "largest_buffer": adapter.buffer,
    })
}

/// All adapters as JSON.
#[pyfunction]
pub(crate) fn adapters(py: Python<'_>) -> PyResult<String> {
    let adapters = guarded(py, || Ok(Gpu::adapters()))?;
    let adapters: Vec<Value> = adapters.iter().map(adapter_json).collect();
    Ok(Value::from(adapters).to_string())
}

/// The plan of a scene as JSON.
#[pyfunction]
pub(crate) fn plan(py: Python<'_>, scene: &Scene, backend: &str, adapter: Option<&str>) -> PyResult<String> {
    let backend = backend_of(backend, adapter)?;
    let scene = Arc::clone(&scene.0);
    let plan = guarded(py, || {
        let on_cpu = backend == Backend::Cpu;
        let memory = HostMemory::new(&scene, &sim::solids_of(&scene)?, on_cpu)?;
        let adapter = match &backend {
            Backend::Cpu => None,
            Backend::Gpu(choice) => match Gpu::find(choice) {
                Ok(adapter) => Some(adapter),
                // A named adapter must exist; otherwise a plan needs none.
                Err(_) if *choice == Default::default() => None,
                Err(error) => return Err(error),
            },
        };
        let plan = Plan::new(&scene, adapter.as_ref())?;
        if let Some(adapter) = &adapter {
            plan.check(adapter)?;
        }
        memory.check()?;
        let stages = plan.stages.iter();
        let stages = stages.filter(|stage| !on_cpu || stage.runner != Runner::Gpu);
        let stages = stages.map(|stage| {
            let kernels: &[_] = if on_cpu { &[] } else { &stage.kernels };
            json!({ "name": stage.name, "every_step": stage.every_step, "kernels": kernels })
        });
        let stages: Vec<Value> = stages.collect();
        let effects = plan
            .effects
            .iter()
            .map(|effect| json!({ "name": effect.name, "active": effect.active, "reason": effect.reason }));
        let effects: Vec<Value> = effects.collect();
        let buffers: Vec<Value> = match on_cpu {
            true => Vec::new(),
            false => {
                plan.buffers.iter().map(|buffer| json!({ "label": buffer.label, "bytes": buffer.bytes() })).collect()
            }
        };
        let bytes = if on_cpu { 0 } else { plan.bytes() };
        Ok(json!({
            "cells": plan.grid.cells, "dx": plan.grid.dx, "markers": plan.n_markers, "nodes": plan.n_nodes, "elements": plan.n_elements,
            "first_dt": plan.first_step.dt, "effects": effects, "stages": stages, "solves": plan.solves, "buffers": buffers,
            "device_bytes": bytes, "adapter": adapter.as_ref().map(adapter_json),
        }))
    })?;
    Ok(plan.to_string())
}

/// The rows of a comparison of all stages as JSON.
#[pyfunction]
pub(crate) fn compare_stages(py: Python<'_>, scene: &Scene, frames: u64, adapter: Option<&str>) -> PyResult<String> {
    let (scene, adapter) = (Arc::clone(&scene.0), choice(adapter));
    let comparison = guarded(py, || compare::compare(&scene, frames, &adapter, &mut |_, _| {}))?;
    let rows = comparison.rows.iter().map(|row| {
        json!({
            "stage": row.stage, "quantity": row.quantity, "unit": row.unit, "count": row.count, "excused": row.excused, "largest": row.largest,
            "rms": row.rms(), "ratio": row.ratio(), "breached": row.breached(),
            "gpu": row.worst.map(|worst| worst.gpu), "twin": row.worst.map(|worst| worst.twin), "bound": row.worst.map(|worst| worst.bound),
            "step": row.worst.map(|worst| worst.step), "place": row.worst.map(|worst| worst.place.to_string()),
        })
    });
    let rows: Vec<Value> = rows.collect();
    Ok(json!({ "rows": rows, "steps": comparison.steps, "adapter": comparison.adapter }).to_string())
}

/// Options of [`run`], from the keywords of the Python function.
#[derive(FromPyObject)]
pub(crate) struct RunKeywords {
    #[pyo3(item)]
    backend: String,
    #[pyo3(item)]
    adapter: Option<String>,
    #[pyo3(item)]
    out: PathBuf,
    #[pyo3(item)]
    frames: Option<u64>,
    #[pyo3(item)]
    overwrite: bool,
    #[pyo3(item)]
    resume: bool,
    #[pyo3(item)]
    keep_going: bool,
}

/// Runs a scene into a folder. `progress` receives frame, frames, time (s) and new notices after each sub-step. An exception of it, or a signal,
/// stops the run after a checkpoint.
#[pyfunction]
pub(crate) fn run(py: Python<'_>, scene: &Scene, keywords: RunKeywords, progress: Py<PyAny>) -> PyResult<String> {
    let options = sim::Options {
        backend: backend_of(&keywords.backend, keywords.adapter.as_deref())?,
        out: keywords.out,
        frames: keywords.frames,
        overwrite: keywords.overwrite,
        resume: keywords.resume,
        keep_going: keywords.keep_going,
    };
    let scene = Arc::clone(&scene.0);
    let interrupt = AtomicBool::new(false);
    let mut raised: Option<PyErr> = None;
    let outcome = guarded(py, || {
        let mut listen = |now: &sim::Progress| {
            let called = Python::attach(|py| {
                py.check_signals()?;
                let notices = now.notices.to_vec();
                progress.call1(py, (now.frame, now.n_frames, now.time, notices))
            });
            if let Err(error) = called {
                raised.get_or_insert(error);
                interrupt.store(true, Ordering::Relaxed);
            }
        };
        Ok(sim::run(&scene, &options, &mut listen, &interrupt))
    })?;
    if let Some(error) = raised {
        return Err(error);
    }
    let summary = outcome.map_err(|error| exception(py, &error))?;
    let tally = &summary.tally;
    Ok(json!({
        "frames": summary.frames, "steps": summary.steps, "seconds": summary.seconds, "worst_residual": tally.worst_residual,
        "volume_ratio": tally.volume_ratio, "missed": tally.missed, "squeezed": tally.squeezed, "dropped": tally.dropped,
        "resumed_at": summary.resumed.as_ref().map(|resumed| resumed.frames), "failed_solids": summary.failed_solids,
    })
    .to_string())
}

/// The command line; returns the exit code. `program`: the command that starts it in another process.
#[pyfunction]
pub(crate) fn command_line(py: Python<'_>, arguments: Vec<OsString>, program: Vec<OsString>) -> u8 {
    let work = || cutwater::cli::main(arguments, Some(&program));
    // A panic has printed its message.
    py.detach(|| catch_unwind(AssertUnwindSafe(work))).unwrap_or(101)
}
