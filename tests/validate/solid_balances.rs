//! What must stay the same: the acceleration of bodies that fall (S13), momentum of free bodies, and what backward Euler takes from their
//! spin.

use cutwater::reference::larger;
use cutwater::scene::Scene;
use glam::DVec3;

use crate::Case;
use crate::lane::{Lane, Motion};
use crate::sheet::Sheet;
use crate::solid_cases::flying_block;
use crate::solid_scene::{block, scene_of};

pub(crate) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for lane in Lane::ALL {
        let name = lane.name();
        cases.push(Case::new(format!("S13/fall/{name}"), move |sheet| free_fall(lane, sheet)));
        cases.push(Case::new(format!("S13/free/{name}"), move |sheet| free_body(lane, sheet)));
        cases.push(Case::new(format!("S13/spin/{name}"), move |sheet| spinning_block(lane, sheet)));
    }
    cases
}

/// Of momenta, relative to the largest that nodes have together: rounding and what the solve leaves in f64; in f32 each node rounds its
/// velocity in every step: sqrt(120) 2^-24 with room for a tail.
fn bound(lane: Lane) -> f64 {
    lane.choose(1e-11, 1e-9, 2e-6)
}

fn free_fall(lane: Lane, sheet: &mut Sheet) {
    let (mass, dt, gravity) = (125.0, 1.0 / 240.0, DVec3::new(0.3, -9.81, 0.0));
    for strained in [false, true] {
        let mut scene = flying_block(strained);
        scene.domain.gravity = gravity;
        let drift = scene.solids[0].initial.velocity;
        let mut motion = Motion::new(lane, &scene, dt);
        let mut worst = 0.0;
        for number in 1..=60 {
            motion.step();
            let exact = drift + f64::from(number) * dt * gravity;
            let [momentum, _] = motion.momenta();
            // Speeds of nodes are those of the fall, of the spin and of the strain: some m/s.
            let off = (momentum / mass).distance(exact) / (1.0 + exact.length());
            worst = larger(worst, off);
        }
        let name = if strained { "spinning and swinging" } else { "quiet" };
        let what = format!("{name} block: velocity of the centre of mass against g t, 60 steps");
        // The device has g, dt and the masses in f32.
        let rounding = lane.choose(0.0, f64::from(f32::EPSILON), 0.0);
        sheet.at_most(&what, worst, bound(lane).max(rounding));
    }
}

/// Balances of a free body that spins and swings, over 0.25 s.
struct Kept {
    /// Largest change of the momentum, over the sum of the nodes' momenta without their directions.
    momentum: f64,
    /// Change of the angular momentum about the centre of mass, relative.
    spin: f64,
    /// Energy at the end over that after the first step.
    energy: f64,
}

fn free_flight(lane: Lane, young: f64, dt: f64) -> Kept {
    let mut scene = flying_block(true);
    scene.solids[0].young = young;
    let mut motion = Motion::new(lane, &scene, dt);
    let [before, spin_before] = motion.momenta();
    let state = motion.state();
    let nodes = state.node_velocity.iter().zip(&motion.solids.mass);
    let scale: f64 = nodes.map(|(v, mass)| mass * DVec3::from(*v).length()).sum();
    let (mut momentum, mut energies) = (0.0, Vec::new());
    for _ in 0..(0.25 / dt).round() as usize {
        let diagnosis = motion.step().diagnosis;
        energies.push(diagnosis.kinetic_energy + diagnosis.elastic_energy);
        momentum = larger(momentum, motion.momenta()[0].distance(before) / scale);
    }
    let centre = DVec3::new(2.0, 3.0, 2.0);
    let spin_before = spin_before - centre.cross(before);
    let spin = motion.momenta()[1] - (centre + 0.25 * before / 125.0).cross(before);
    Kept {
        momentum,
        spin: spin.distance(spin_before) / spin_before.length(),
        energy: energies[energies.len() - 1] / energies[0],
    }
}

/// Momentum is kept whatever the step. The forces of the new positions are taken with the rotations and the stiffness of the old ones,
/// which turns a strained body by a moment of the order of dt: angular momentum is kept to the first order, as long as steps are short
/// enough for the strain not to be damped away first (w^2 dt times the time below 1). For a stiff body it is informational.
fn free_body(lane: Lane, sheet: &mut Sheet) {
    let mut changes = Vec::new();
    for (young, dts) in [(1e4, &[240.0, 480.0, 960.0][..]), (1e6, &[240.0])] {
        for rate in dts {
            let kept = free_flight(lane, young, 1.0 / rate);
            let what = format!("block of E {young:.0e} Pa that spins and swings, dt 1/{rate} s");
            sheet.at_most(&format!("{what}: change of momentum in 0.25 s"), kept.momentum, bound(lane));
            sheet.info(
                &format!("{what}: change of angular momentum; part of the energy left"),
                format!("{:.1e}; {:.3}", kept.spin, kept.energy),
            );
            changes.push(kept.spin);
        }
    }
    for (number, from) in [240, 480].into_iter().enumerate() {
        let what = format!("order in dt of the change of angular momentum, from 1/{from} s");
        let order = (changes[number] / changes[number + 1]).log2();
        sheet.at_least(&what, order, 0.8);
    }
}

/// A stiff block that spins about its axis of largest inertia.
fn spinning() -> Scene {
    let mut solid = block([0.4, 0.1, 0.4], [4, 1, 4]);
    solid.placement.translate = DVec3::splat(2.0);
    solid.young = 1e8;
    solid.initial.spin = DVec3::new(0.0, 4.0, 0.0);
    scene_of(vec![solid])
}

/// A rigid rotation. Nodes move along the tangent and are pulled back by forces through the axis, so that next to nothing is lost: the
/// loss is below the square of the angle of a step.
fn spinning_block(lane: Lane, sheet: &mut Sheet) {
    let time = 0.25;
    for steps in [60.0, 120.0, 240.0] {
        let mut motion = Motion::new(lane, &spinning(), time / steps);
        let [_, before] = motion.momenta();
        let mut energies = Vec::new();
        for _ in 0..steps as usize {
            let diagnosis = motion.step().diagnosis;
            energies.push(diagnosis.kinetic_energy + diagnosis.elastic_energy);
        }
        let [_, after] = motion.momenta();
        let angle: f64 = 4.0 * time / steps;
        let what = format!("stiff block, {angle:.4} rad a step: change of angular momentum in 1 rad");
        sheet.at_most(&what, after.distance(before) / before.length(), angle * angle);
        let most = energies.iter().copied().fold(0.0, larger);
        sheet.info(
            &format!("{angle:.4} rad a step: largest and last energy over the first"),
            format!("{:.6}, {:.6}", most / energies[0], energies[energies.len() - 1] / energies[0]),
        );
    }
}
