//! Changes of a simulation between two sub-steps: gravity, prescribed motions and velocities.
//!
//! A motion may change from the present time on only: a body that jumped would overlap the liquid at its new place. The nodes of a script move with
//! the velocity from the last sub-step, so they follow a new script one sub-step later than an obstacle.

use glam::DVec3;

use super::{Path, Simulation, first_contact_step};
use crate::Error;
use crate::grid::Axis;
use crate::scene::{Keyframe, MAX_VELOCITY, Scene};
use crate::state::State;

/// Largest distance (m, over the longest edge of the domain) and angle (rad) between the old and the new pose at the present time.
const SAME_POSE: f64 = 1e-9;

impl Simulation {
    /// Sets gravity, m/s^2, in place of keyframes. Probes of heights keep their direction.
    ///
    /// # Errors
    /// [`Error::Input`] for numbers that are not finite.
    pub fn set_gravity(&mut self, gravity: DVec3) -> Result<(), Error> {
        if !(gravity.is_finite() && gravity.abs().max_element() <= MAX_VELOCITY) {
            return Err(Error::input(
                "gravity",
                format!("is {gravity} m/s^2"),
                format!("use numbers of at most {MAX_VELOCITY:e}"),
            ));
        }
        self.scene.domain.gravity = gravity;
        self.scene.domain.gravity_keyframes.clear();
        self.follow();
        Ok(())
    }

    /// Replaces the keyframes of a moving obstacle, by its index in the scene.
    ///
    /// # Errors
    /// [`Error::Input`] for an obstacle without keyframes, keyframes that are not ascending or not finite, and another pose at the present time.
    pub fn set_motion(&mut self, obstacle: usize, keyframes: Vec<Keyframe>) -> Result<(), Error> {
        let name = format!("obstacle[{obstacle}]");
        let motion = self.scene.obstacles.get(obstacle);
        let motion = motion.and_then(|obstacle| obstacle.motion.as_ref());
        let Some(motion) = motion else {
            return Err(Error::input(
                name,
                "the scene has no such obstacle with keyframes, and the others are fixed parts of the grid",
                "give the obstacle keyframes in the scene; one at t = 0 is enough",
            ));
        };
        let time = self.clock().time;
        ensure_continuous(&self.scene, &name, time, [&motion.keyframes, &keyframes])?;
        if let Some(motion) = &mut self.scene.obstacles[obstacle].motion {
            motion.keyframes = keyframes;
        }
        self.follow();
        if self.clock().step > 0 || self.solids.rest.is_empty() {
            return Ok(());
        }
        let first = self.first_contact_step(&self.state()?);
        match &mut self.path {
            Path::Gpu(path) => path.limit_step(first),
            Path::Cpu(path) => path.limit_step(first),
        }
        Ok(())
    }

    /// The limit of the next sub-step by contact for velocities that are set, s; 0 without.
    fn first_contact_step(&self, state: &State) -> f64 {
        let mut field = match &self.path {
            Path::Gpu(path) => path.contact_field(),
            Path::Cpu(path) => path.contact_field(),
        };
        field.move_to(state.time, 0.0);
        first_contact_step(&self.scene, &self.solids, &field, state)
    }

    /// Replaces the keyframes of a script, by the indices of its solid in the scene and of the script in the solid.
    ///
    /// # Errors
    /// [`Error::Input`] for a script that does not exist, a rotation about a region without centre, keyframes that are not ascending or not finite,
    /// and another pose at the present time.
    pub fn set_script(&mut self, solid: usize, script: usize, keyframes: Vec<Keyframe>) -> Result<(), Error> {
        let name = format!("solid[{solid}].script[{script}]");
        let time = self.clock().time;
        let pins = self.scene.solids.get(solid).map(|solid| &solid.pins);
        let pins = pins.into_iter().flatten().enumerate();
        let mut scripts = pins.filter(|(_, pin)| !pin.keyframes.is_empty());
        let Some((number, pin)) = scripts.nth(script) else {
            let cure = "give the solid a [[solid.script]] in the scene; one keyframe is enough";
            return Err(Error::input(name, "the scene has no such script", cure));
        };
        let centre = pin.pivot.or(pin.region.centre());
        if centre.is_none() && keyframes.iter().any(|frame| frame.angle != 0.0) {
            return Err(Error::input(
                name,
                "rotates its nodes about the centre of its region, which has none",
                "give the script a pivot in the scene, or remove the rotation",
            ));
        }
        ensure_continuous(&self.scene, &name, time, [&pin.keyframes, &keyframes])?;
        self.scene.solids[solid].pins[number].keyframes = keyframes;
        self.follow();
        Ok(())
    }

    fn follow(&mut self) {
        self.solids.follow(&self.scene);
        match &mut self.path {
            Path::Gpu(path) => path.follow(&self.scene),
            Path::Cpu(path) => path.follow(&self.scene),
        }
    }

    /// Replaces the velocities (m/s) of the faces, of the nodes, or of both. Prescribed components of nodes keep theirs. The next pressure
    /// solve makes them free of divergence.
    ///
    /// # Errors
    /// [`Error::Input`] for other lengths than those of the state and for numbers that are not finite; errors of the device.
    pub fn set_velocity(&mut self, faces: Option<[Vec<f64>; 3]>, nodes: Option<Vec<[f64; 3]>>) -> Result<(), Error> {
        let (mut state, mut carried) = (self.state()?, self.carried()?);
        if let Some(faces) = faces {
            for axis in Axis::ALL.map(Axis::index) {
                let name = format!("the velocities of the faces along {}", ["x", "y", "z"][axis]);
                let expected = state.velocity[axis].len();
                ensure_velocities(&name, faces[axis].len(), expected, &faces[axis])?;
            }
            carried.max_speed[0] = fastest(faces.iter().flatten());
            state.velocity = faces;
        }
        if let Some(nodes) = nodes {
            let name = "the velocities of the nodes";
            let expected = state.node_velocity.len();
            ensure_velocities(name, nodes.len(), expected, nodes.as_flattened())?;
            let old = state.node_velocity.iter_mut();
            for ((old, new), prescribed) in old.zip(nodes).zip(&self.solids.prescribed) {
                for axis in (0..3).filter(|&axis| !prescribed[axis]) {
                    old[axis] = new[axis];
                }
            }
            carried.max_speed[1] = fastest(state.node_velocity.as_flattened());
            state.contact_step = self.first_contact_step(&state);
        }
        self.resume(&state, &carried)
    }
}

/// Largest magnitude.
fn fastest<'a>(values: impl IntoIterator<Item = &'a f64>) -> f64 {
    values.into_iter().fold(0.0, |most, v| most.max(v.abs()))
}

fn ensure_velocities(name: &str, length: usize, expected: usize, values: &[f64]) -> Result<(), Error> {
    if length != expected {
        let problem = format!("there are {length}, and the simulation has {expected}");
        return Err(Error::input(name, problem, "change a copy of those of the present state"));
    }
    match values.iter().position(|v| !v.is_finite() || v.abs() > MAX_VELOCITY) {
        None => Ok(()),
        Some(at) => Err(Error::input(
            name,
            format!("number {at} is {} m/s", values[at]),
            format!("use numbers of at most {MAX_VELOCITY:e}"),
        )),
    }
}

/// Checks new keyframes, and that they have the pose of the old ones at the present time (s).
fn ensure_continuous(scene: &Scene, name: &str, time: f64, [old, new]: [&[Keyframe]; 2]) -> Result<(), Error> {
    let refused = |problem: String, cure: &str| Err(Error::input(name, problem, cure));
    let finite = |frame: &Keyframe| {
        let numbers = [frame.time, frame.angle];
        numbers.iter().all(|x| x.is_finite()) && frame.translate.is_finite()
    };
    if new.is_empty() || !new.iter().all(finite) {
        let problem = "the keyframes are none, or have numbers that are not finite";
        return refused(problem.to_owned(), "give at least one, in s, m and degrees");
    }
    if new.windows(2).any(|pair| pair[1].time <= pair[0].time) {
        let problem = "the times of the keyframes do not ascend".to_owned();
        return refused(problem, "write them in ascending order of time");
    }
    let edge = scene.grid().size().max_element();
    for pair in new.windows(2) {
        let span = pair[1].time - pair[0].time;
        let speed = Keyframe::max_speed(pair, edge, pair[0].time, span);
        if speed > MAX_VELOCITY {
            let problem = format!("it moves at {speed:e} m/s after {} s", pair[0].time);
            return refused(problem, "use a longer time or a shorter distance");
        }
    }
    let [before, after] = [old, new].map(|keyframes| Keyframe::pose(keyframes, time));
    let turned = before.0.distance(after.0);
    let moved = before.1.distance(after.1);
    if turned <= SAME_POSE && moved <= SAME_POSE * edge {
        return Ok(());
    }
    refused(
        format!(
            "at the present time, {time} s, the new motion is {moved:.3e} m and {turned:.3e} rad away from the old one"
        ),
        "let it begin with a keyframe at that time and of that pose",
    )
}
