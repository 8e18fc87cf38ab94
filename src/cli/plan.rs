//! `cutwater plan`

use crate::Error;
use crate::gpu::{AdapterReport, BufferPlan, Gpu};
use crate::scene::Scene;
use crate::sim::{self, Backend, HostMemory, Plan, StagePlan};
use crate::step::Runner;

use super::{BackendArgs, SceneArgs};

/// List the effects, stages, kernels and buffers of a scene, and check the limits of the adapter
#[derive(Debug, clap::Args)]
pub(super) struct PlanCommand {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    backend: BackendArgs,
}

impl PlanCommand {
    pub(super) fn run(&self) -> Result<(), Error> {
        let scene = self.scene.load()?;
        super::run::warn_before_run(&scene)?;
        let memory = |on_cpu| HostMemory::new(&scene, &sim::solids_of(&scene)?, on_cpu);
        match self.backend.backend() {
            Backend::Cpu => {
                let plan = Plan::new(&scene, None)?;
                say_scene(&scene, &plan);
                say_effects(&plan);
                say!("\nstages of a sub-step, each in f64 on the CPU");
                let shared = |stage: &&StagePlan| stage.runner != Runner::Gpu;
                for stage in plan.stages.iter().filter(shared) {
                    say!("  {}", stage.name);
                }
                say!("\nno kernels, no buffers on a device, no adapter");
                say_memory(memory(true)?)
            }
            Backend::Gpu(choice) => {
                // A named adapter must exist; otherwise a plan needs none.
                let adapter = match Gpu::find(&choice) {
                    Ok(adapter) => Some(adapter),
                    Err(_) if choice == Default::default() => None,
                    Err(error) => return Err(error),
                };
                let plan = Plan::new(&scene, adapter.as_ref())?;
                say_scene(&scene, &plan);
                say_effects(&plan);
                say_stages(&plan);
                say_solves(&plan);
                say_buffers(&plan);
                match adapter {
                    Some(adapter) => {
                        say_limits(&plan, &adapter)?;
                        say_memory(memory(false)?.beside(plan.bytes(), &adapter))?;
                        say!("the scene fits; the free memory of the adapter is unknown");
                    }
                    None => {
                        say!("\nno adapter was checked: none is present. The plan is for one with f64.");
                        plan.check_formulation()?;
                        say_memory(memory(false)?)?;
                    }
                }
                Ok(())
            }
        }
    }
}

fn say_scene(scene: &Scene, plan: &Plan) {
    let [nx, ny, nz] = plan.grid.cells;
    say!("{}", scene.file.display());
    say!("  {nx} x {ny} x {nz} cells of {} m: {}, padded {}", plan.grid.dx, plan.grid.n_cells(), plan.padded_cells);
    if plan.n_markers > 0 {
        say!("  about {} markers", plan.n_markers);
    }
    if plan.n_nodes > 0 {
        say!("  solids: {} nodes, {} elements", plan.n_nodes, plan.n_elements);
    }
    for (number, flow) in plan.sources.iter().enumerate() {
        let share = 100.0 * flow.flow_rate / flow.unobstructed;
        let covered = match share < 99.0 {
            true => format!(", {share:.1} % of its unobstructed flow: walls cover the rest"),
            false => String::new(),
        };
        let most = if scene.sources[number].keyframes.is_empty() { "" } else { "at most " };
        let speed = flow.velocity.length();
        say!("  source[{number}] emits {most}{:.4e} m^3/s at {speed:.4} m/s{covered}", flow.flow_rate);
    }
    let frame = 1.0 / scene.time.frames_per_second;
    say!(
        "  {} frames of {frame:.4} s; first sub-step {:.2e} s, {:.0} a frame",
        scene.n_frames(),
        plan.first_step.dt,
        (frame / plan.first_step.dt).round()
    );
}

fn say_effects(plan: &Plan) {
    say!("\neffects");
    for effect in &plan.effects {
        let present = if effect.active { "yes" } else { "no" };
        say!("  {:15} {present:4} {}", effect.name, effect.reason);
    }
}

fn say_stages(plan: &Plan) {
    say!("\nstages of a sub-step: kernels");
    for stage in &plan.stages {
        let once = if stage.every_step { "" } else { "  (once, before the first sub-step)" };
        say!("  {:15} {}{once}", stage.name, stage.kernels.join(", "));
    }
}

fn say_solves(plan: &Plan) {
    say!("\nsolve");
    for solve in &plan.solves {
        say!("  {solve}");
    }
    if plan.host_turns {
        say!(
            "  the adapter has no f64: the host evaluates residuals and transfers {} per refinement step",
            mebibytes(plan.bytes_per_turn)
        );
    }
}

fn say_buffers(plan: &Plan) {
    say!("\n{:32} {:>12} {:>14}", "buffers", "elements", "bytes");
    for buffer in &plan.buffers {
        say!("  {:30} {:12} {:14}", buffer.label, buffer.len, buffer.bytes());
    }
    say!("  {:30} {:12} {:14}  ({})", "all", "", plan.bytes(), mebibytes(plan.bytes()));
    if plan.n_nodes == 0 {
        say!("  {:.1} bytes per padded cell, {:.0} per marker", plan.bytes_per_cell(), plan.bytes_per_marker());
    }
}

/// Prints the limits of the adapter; a limit that is too small is an error.
fn say_limits(plan: &Plan, adapter: &AdapterReport) -> Result<(), Error> {
    say!("\nadapter {} ({})", adapter.name, adapter.kind);
    let largest = plan.buffers.iter().max_by_key(|buffer| buffer.bytes()).map_or(0, BufferPlan::bytes);
    let buffer_limits = [
        ("max_storage_buffer_binding_size", largest, adapter.storage_binding),
        ("max_buffer_size", largest, adapter.buffer),
    ];
    let kernel_limits = adapter.needed_limits().map(|limit| (limit.name, limit.needed.into(), limit.available.into()));
    for (limit, needed, allowed) in buffer_limits.into_iter().chain(kernel_limits) {
        let verdict = if needed <= allowed { "fits" } else { "TOO SMALL" };
        say!("  {limit:37} needs {needed:12}, allows {allowed:20}: {verdict}");
    }
    let too_large: Vec<&str> = plan
        .buffers
        .iter()
        .filter(|buffer| adapter.check_buffer(&buffer.label, buffer.bytes()).is_err())
        .map(|buffer| &*buffer.label)
        .collect();
    if !too_large.is_empty() {
        say!("  too large: {}", too_large.join(", "));
    }
    plan.check(adapter)
}

fn say_memory(memory: HostMemory) -> Result<(), Error> {
    say!("\nmemory of this machine: at least {}, free {}", mebibytes(memory.needed), mebibytes(memory.available));
    memory.check()
}

fn mebibytes(bytes: u64) -> String {
    format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20))
}
