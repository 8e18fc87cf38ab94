//! `domain.slab`: a plane problem as a slab of one or two cells between two frictionless walls.
//!
//! Its thickness follows from its cells, which `--scale` does not change. `domain.size` across it is the thickness to which the scene and its
//! probes refer. All lengths across, total forces and flow rates are scaled from it to the thickness of the slab. Nodes of solids slide in
//! the plane.

use glam::DVec3;

use super::{Domain, Keyframe, LoadKind, Pin, Placement, ProbeKind, ProbedNodes, Scene, Shape, SolidMesh};
use crate::error::Error;

/// Most cells across a slab.
pub(super) const MAX_CELLS: usize = 2;
/// Rounding of directions, and of lengths relative to the thickness.
const TOLERANCE: f64 = 1e-9;
/// A plane beyond all nodes, m.
const BEYOND: f64 = 1e9;

/// A plane problem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slab {
    /// Axis across the slab: 0, 1, 2 for x, y, z.
    pub axis: usize,
    /// Thickness over that of the scene file.
    pub stretch: f64,
}

impl Slab {
    /// Factors of lengths along the axes.
    pub(super) fn stretches(self) -> DVec3 {
        let mut stretches = DVec3::ONE;
        stretches[self.axis] = self.stretch;
        stretches
    }

    /// Factors of the columns of a probe that convert them to the thickness of the scene file; `None` for those that need none.
    pub(crate) fn probe_factors(self, kind: &ProbeKind) -> Option<[f64; 4]> {
        let per_thickness = 1.0 / self.stretch;
        match kind {
            ProbeKind::Force { .. } | ProbeKind::Reaction { .. } | ProbeKind::Flux { .. } => Some([per_thickness; 4]),
            ProbeKind::Solid { .. } => {
                let mut factors = [1.0; 4];
                factors[self.axis] = per_thickness;
                Some(factors)
            }
            _ => None,
        }
    }
}

impl Domain {
    /// The domain with the thickness of its slab.
    pub(super) fn stretched(&self) -> Domain {
        let stretches = self.slab.map_or(DVec3::ONE, Slab::stretches);
        Domain { size: self.size * stretches, ..self.clone() }
    }
}

/// Problem and cure.
type Refusal = [String; 2];

/// Stretches a scene from the thickness of its file to that of its slab, and adds rollers to its solids.
///
/// # Errors
/// [`Error::Input`] for what varies across the slab.
pub(super) fn stretch(scene: &mut Scene) -> Result<(), Error> {
    let Some(slab) = scene.domain.slab else {
        return Ok(());
    };
    let Slab { axis, stretch } = slab;
    let name = ["x", "y", "z"][axis];
    let origins = scene.clone();
    let fail = |key: String, [problem, cure]: Refusal| Error::input(origins.at(&key), problem, cure);
    let across =
        |what: &str| [format!("{what} varies along {name}, across the slab"), format!("let nothing vary along {name}")];
    let thickness = scene.domain.size[axis];
    let slack = TOLERANCE * thickness;
    if scene.domain.largest_gravity()[axis] != 0.0 {
        return Err(fail("domain.gravity".to_owned(), across("gravity")));
    }
    if [0, 1].into_iter().any(|side| scene.domain.open.has(crate::grid::Axis::ALL[axis], side)) {
        let cure = format!("keep the sides -{name} and +{name} closed");
        return Err(fail("domain.open".to_owned(), ["opens a wall of the slab".to_owned(), cure]));
    }
    for (number, region) in scene.liquid.iter_mut().flat_map(|liquid| &mut liquid.regions).enumerate() {
        let at = |error| fail(format!("liquid.region[{number}]"), error);
        shape(slab, &mut region.shape).map_err(at)?;
        placement(slab, &mut region.placement).map_err(at)?;
        if region.velocity[axis] != 0.0 {
            return Err(at(across("its velocity")));
        }
    }
    for (number, obstacle) in scene.obstacles.iter_mut().enumerate() {
        let at = |error| fail(format!("obstacle[{number}]"), error);
        shape(slab, &mut obstacle.shape).map_err(at)?;
        placement(slab, &mut obstacle.placement).map_err(at)?;
        if let Some(motion) = &obstacle.motion {
            keyframes(slab, &motion.keyframes).map_err(at)?;
        }
    }
    for (number, source) in scene.sources.iter_mut().enumerate() {
        let at = |error| fail(format!("source[{number}]"), error);
        shape(slab, &mut source.shape).map_err(at)?;
        source.flow_rate = source.flow_rate.map(|rate| rate * stretch);
        if source.velocity[axis] != 0.0 {
            return Err(at(across("its velocity")));
        }
    }
    for (number, sink) in scene.sinks.iter_mut().enumerate() {
        shape(slab, &mut sink.shape).map_err(|error| fail(format!("sink[{number}]"), error))?;
    }
    for (number, solid) in scene.solids.iter_mut().enumerate() {
        let key = format!("solid[{number}]");
        let at = |error| fail(key.clone(), error);
        match solid.mesh {
            SolidMesh::Sphere { .. } | SolidMesh::Shell { .. } => {
                let cure = "use a box, or a mesh file of a disc that reaches across";
                return Err(at([across("a ball")[0].clone(), cure.to_owned()]));
            }
            SolidMesh::Box { size, .. } => {
                let half = 0.5 * (solid.placement.scale * (solid.placement.rotate * size).abs())[axis];
                let middle = solid.placement.translate[axis];
                if !solid.placement.is_along(axis) {
                    return Err(at([
                        "its placement turns it out of the plane".to_owned(),
                        format!("let placement.rotate.axis point along {name}"),
                    ]));
                }
                if (middle - half).abs() > slack || (middle + half - thickness).abs() > slack {
                    return Err(at([
                        format!(
                            "leaves a gap to the walls of the slab: along {name} it extends from {} to {} m",
                            middle - half,
                            middle + half
                        ),
                        format!("let it extend from 0 to {thickness} m along {name}: size and placement.at"),
                    ]));
                }
            }
            SolidMesh::File { .. } | SolidMesh::Surface { .. } => {}
        }
        let initial = &solid.initial;
        let varies = initial.velocity_gradient.iter().any(|gradient| gradient[axis] != 0.0);
        if let Some(key) = initial.moves_along(axis).or(varies.then_some("initial.velocity_gradient")) {
            let cure =
                format!("let the body move and deform in the plane only, which the rollers allow, not along {name}");
            return Err(at([format!("{key} moves it out of the plane of the slab"), cure]));
        }
        solid.stretch = slab.stretches();
        for pin in &mut solid.pins {
            shape(slab, &mut pin.region).map_err(at)?;
            keyframes(slab, &pin.keyframes).map_err(at)?;
            // The rollers constrain it.
            pin.components[axis] &= pin.keyframes.is_empty();
        }
        for load in &mut solid.loads {
            shape(slab, &mut load.region).map_err(at)?;
            let (LoadKind::Force(value) | LoadKind::Traction(value)) = load.kind;
            if value[axis] != 0.0 || load.keyframes.iter().any(|frame| frame.value[axis] != 0.0) {
                return Err(at(across("a load")));
            }
            if let LoadKind::Force(force) = &mut load.kind {
                *force *= stretch;
                let keyframes = load.keyframes.iter_mut();
                keyframes.for_each(|frame| frame.value *= stretch);
            }
        }
        let normal = DVec3::AXES[axis];
        solid.pins.push(Pin {
            region: Shape::HalfSpace { point: BEYOND * normal, normal },
            components: std::array::from_fn(|component| component == axis),
            keyframes: Vec::new(),
            pivot: None,
        });
    }
    for (number, probe) in scene.probes.iter_mut().enumerate() {
        let at = |error| fail(format!("probe[{number}]"), error);
        match &mut probe.kind {
            ProbeKind::Height { foot: point, .. }
            | ProbeKind::Pressure { point }
            | ProbeKind::Velocity { point }
            | ProbeKind::Node { nodes: ProbedNodes::Nearest(point), .. } => point[axis] *= stretch,
            ProbeKind::Node { nodes: ProbedNodes::Within(region), .. }
            | ProbeKind::Reaction { region: Some(region), .. } => shape(slab, region).map_err(at)?,
            ProbeKind::Flux { axis: normal, min, max } => {
                if *normal == axis {
                    return Err(at(across("its flux")));
                }
                min[axis] *= stretch;
                max[axis] *= stretch;
            }
            ProbeKind::Front { axis: along, .. } if *along == axis => {
                return Err(at(across("its front")));
            }
            ProbeKind::Front { .. }
            | ProbeKind::Reaction { region: None, .. }
            | ProbeKind::Force { .. }
            | ProbeKind::Solid { .. }
            | ProbeKind::SolidVelocity { .. } => {}
        }
    }
    scene.domain = scene.domain.stretched();
    Ok(())
}

/// Stretches a shape that does not vary across the slab.
fn shape(Slab { axis, stretch }: Slab, shape: &mut Shape) -> Result<(), Refusal> {
    let name = ["x", "y", "z"][axis];
    let varies =
        |what: &str, cure: &str| Err([format!("{what} varies along {name}, across the slab"), cure.to_owned()]);
    let horizontal = |numbers: &[f64; 2]| match axis {
        0 => numbers[0] != 0.0,
        1 => true,
        _ => numbers[1] != 0.0,
    };
    match shape {
        Shape::Box { min, max } => {
            min[axis] *= stretch;
            max[axis] *= stretch;
        }
        Shape::Cylinder { base, axis: along, height, .. } => {
            if along.reject_from_normalized(DVec3::AXES[axis]).length() > TOLERANCE {
                return varies("the cylinder", &format!("let its axis point along {name}"));
            }
            base[axis] *= stretch;
            *height *= stretch;
        }
        Shape::HalfSpace { point, normal } => {
            if normal[axis].abs() > TOLERANCE {
                return varies("the half space", &format!("let its normal have no part along {name}"));
            }
            point[axis] *= stretch;
        }
        Shape::Sphere { .. } => return varies("a sphere", &format!("use a cylinder along {name}")),
        Shape::Wave { wave_number, .. } if horizontal(wave_number) => {
            return varies("the wave", &format!("let its wave_number have no part along {name}"));
        }
        Shape::Solitary(wave) if horizontal(&wave.direction) => {
            return varies("the wave", &format!("let its direction have no part along {name}"));
        }
        // A mesh has to reach across at every scale.
        Shape::Wave { .. } | Shape::Solitary(_) | Shape::Mesh { .. } => {}
    }
    Ok(())
}

/// Stretches a placement that turns about the axis across the slab.
fn placement(Slab { axis, stretch }: Slab, placement: &mut Placement) -> Result<(), Refusal> {
    if !placement.is_along(axis) {
        let name = ["x", "y", "z"][axis];
        return Err([
            "its placement turns it out of the plane".to_owned(),
            format!("let placement.rotate.axis point along {name}"),
        ]);
    }
    placement.translate[axis] *= stretch;
    if let Some(at) = &mut placement.at {
        at[axis] *= stretch;
    }
    Ok(())
}

/// Refuses a motion out of the plane.
fn keyframes(Slab { axis, .. }: Slab, keyframes: &[Keyframe]) -> Result<(), Refusal> {
    if keyframes.iter().any(|frame| frame.moves_along(axis)) {
        let name = ["x", "y", "z"][axis];
        return Err([
            "its keyframes move it out of the plane".to_owned(),
            format!("translate it across {name}, and rotate it about {name}"),
        ]);
    }
    Ok(())
}

impl Placement {
    /// Whether it turns about a coordinate axis only.
    fn is_along(&self, axis: usize) -> bool {
        let normal = DVec3::AXES[axis];
        (self.rotate * normal - normal).length() <= TOLERANCE
    }
}
