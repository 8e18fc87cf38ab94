//! `diagnose`: sums and extremes of liquid and solids, and the forces of the liquid on the solids. `liquid_distance`
//! measures volume and potential energy.
//!
//! A fixed number of threads sums fixed shares of the band, then one workgroup sums these in a tree. The order
//! depends on grid and band only, so results repeat bit for bit.

use crate::Error;
use crate::fields::{
    ClipBuffers, CouplingBuffers, CouplingReport, LevelBuffers, LiquidBuffers, SolidBuffers, SolverBuffers,
};
use crate::gpu::{Dispatches, Gpu, Kernel, RealBuffer, Source, Variant};
use crate::step::Stage;
use crate::wgsl;

/// The stage for the liquid: arrays to `report`. With a level, volumes too, with the markers that fly. With solids in liquid, `solids` contains the clipping, J, and the
/// node velocities (`Real4`, m/s).
pub fn diagnose(
    gpu: &Gpu,
    (liquid, level): (&LiquidBuffers, Option<&LevelBuffers>),
    solver: &SolverBuffers,
    solids: Option<(&ClipBuffers, &CouplingBuffers, &RealBuffer)>,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Diagnose.name());
    let real = liquid.plan.real;
    // The divergence of separated cells does not vanish.
    let flags = liquid.projected.as_ref().unwrap_or(&solver.flags);
    let open = [("open", liquid.solve_open().into()), ("flags", flags.into())];
    let with_flux = |real| Variant::from(real).beside_obstacles(liquid.obstacle_flux.is_some());
    let filled = level.map(|level| ("liquid_distance", (&level.next_level).into()));
    let bound = |source: Source| {
        // Volumes are those of the filled parts.
        let own = filled.filter(|_| source.name.starts_with("measure_"));
        Kernel::new(gpu, &source, real)?.bind(gpu, own.as_slice(), &[liquid, &level])
    };
    let summing = |source| Ok::<_, Error>(bound(source)?.threads(liquid.plan.n_summing()));
    let mut list = Vec::new();
    if let Some(level) = level {
        let spray = bound(wgsl!("sum_spray"))?;
        list.push(spray.indirect(&level.marker_args, 0));
        list.push(bound(wgsl!("filled_distance"))?.indirect(&liquid.band_args, 0));
        list.push(summing(wgsl!("measure_volume"))?);
        list.push(bound(wgsl!("add_spray_volume"))?.threads(1));
        list.push(bound(wgsl!("report_volume"))?.threads(1));
    }
    list.push(summing(wgsl!("measure_motion"))?);
    if level.is_some() {
        list.push(bound(wgsl!("add_spray_motion"))?.threads(1));
    }
    let clip = solids.map(|(clip, ..)| clip);
    let divergence = match solids {
        Some(_) => wgsl!("measure_uncut_divergence"),
        None => wgsl!("measure_divergence"),
    };
    let divergence = Kernel::new(gpu, &divergence, with_flux(real))?.bind(gpu, &open, &[&clip, solver, liquid])?;
    list.push(divergence.indirect(&solver.args, 0));
    if let Some((_, coupling, x)) = solids {
        let own = [("x", x.into()), open[0], open[1]];
        let kernel = Kernel::new(gpu, &wgsl!("measure_cut_divergence"), with_flux(x.real))?;
        let bound = kernel.bind(gpu, &own, &[liquid, solver, coupling])?;
        list.push(bound.threads(coupling.size.quads));
    }
    list.push(bound(wgsl!("report_motion"))?.threads(1));
    let stage = Dispatches::new(Stage::Diagnose.name(), list).clearing(&liquid.maxima);
    Ok(match level {
        Some(level) => stage.clearing(&level.spray_sums),
        None => stage,
    })
}

/// The stage for the solids: arrays to `report`.
pub fn diagnose_solid(gpu: &Gpu, solids: &SolidBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Diagnose.name());
    let bound = |source| Kernel::new(gpu, &source, solids.plan.real)?.bind(gpu, &[], &[solids]);
    let list =
        [bound(wgsl!("measure_solid"))?.threads(solids.plan.n_summing()), bound(wgsl!("report_solid"))?.threads(1)];
    Ok(Dispatches::new(Stage::Diagnose.name(), list).clearing(&solids.extremes))
}

/// The stage for the coupling: sums of J^T p and of `correction` over the nodes, to `report`. `correction`: forces
/// due to pressure variation within cells, `Real4` per node, N.
pub fn diagnose_coupling(
    gpu: &Gpu,
    solver: &SolverBuffers,
    coupling: &CouplingBuffers,
    correction: Option<&RealBuffer>,
) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Diagnose.name());
    let own = [("p", (&solver.potential).into())];
    let measure =
        Kernel::new(gpu, &wgsl!("measure_coupling"), coupling.partials.real)?.bind(gpu, &own, &[coupling, solver])?;
    let mut list = vec![measure.threads(coupling.n_nodes)];
    let forces = [(&coupling.partials, CouplingReport::FORCE)].into_iter();
    let corrections = correction.map(|correction| (correction, CouplingReport::CORRECTION));
    for (forces, word) in forces.chain(corrections) {
        let first = gpu.uniform("coupling.first", &[word, 0, 0, 0])?;
        let own = [("first", (&first).into()), ("partials", forces.into())];
        let kernel = Kernel::new(gpu, &wgsl!("report_coupling"), forces.real)?;
        list.push(kernel.bind(gpu, &own, &[coupling])?.threads(1));
    }
    Ok(Dispatches::new(Stage::Diagnose.name(), list))
}
