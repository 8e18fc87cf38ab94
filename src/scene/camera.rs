//! The camera, its path, and where it stands when the scene does not say.

use glam::DVec3;

use super::document::{Keys, Place, Table};
use super::shape::corners;
use super::{Camera, CameraCut, CameraKeyframe, Domain, Time};
use crate::error::Error;

/// Sides of pictures, pixels.
pub const PICTURE_SIDES: std::ops::RangeInclusive<usize> = 16..=8192;

const CAMERA: Keys = Keys {
    valid: &["eye", "target", "up", "fov", "size", "keyframes", "cut"],
    absent: &[],
};
const CUT: Keys = Keys {
    valid: &["axis", "at"],
    absent: &[],
};
const KEYFRAME: Keys = Keys {
    valid: &["t", "eye", "target", "fov"],
    absent: &[],
};

/// The camera of a scene.
pub(super) fn camera(root: &Table, domain: &Domain, time: &Time) -> Result<Camera, Error> {
    let mut camera = Camera::looking_at(domain);
    let Some(place) = root.get("camera") else {
        return Ok(camera);
    };
    let table = place.table(&CAMERA)?;
    if let Some(place) = table.get("up") {
        camera.up = place.direction("the direction that is up in the picture")?;
    }
    if let Some(place) = table.get("fov") {
        camera.fov = opening(&place)?;
    }
    if let Some(place) = table.get("size") {
        camera.size = place.counts(
            "the width and height of the picture in pixels",
            *PICTURE_SIDES.start() as u64,
            *PICTURE_SIDES.end() as u64,
        )?;
    }
    if let Some(place) = table.get("target") {
        camera.target = place.vector(TARGET)?;
    }
    if let Some(place) = table.get("cut") {
        camera.cut = Some(cut(&place, domain)?);
    }
    let keyframes = table.get("keyframes");
    match table.get("eye") {
        Some(place) => {
            place.ensure(
                keyframes.is_none(),
                "stands beside keyframes, which say where the camera is",
                "remove one of both",
            )?;
            camera.eye = place.vector(EYE)?;
            ensure_view(&place, &camera.pose(0.0), camera.up, "")?;
        }
        None => camera.step_back(domain),
    }
    if let Some(place) = keyframes {
        let places = path(&place, &mut camera)?;
        // Between keyframes the path is curved.
        let frames = (time.duration * time.frames_per_second).round() as u64;
        for frame in 0..=frames {
            let pose = camera.pose(frame as f64 / time.frames_per_second);
            let later = camera.keyframes.partition_point(|at| at.time <= pose.time);
            let when = format!(" at {} s", pose.time);
            ensure_view(&places[later.max(1) - 1], &pose, camera.up, &when)?;
        }
        camera.eye = camera.keyframes[0].eye;
    }
    Ok(camera)
}

const EYE: &str = "the position of the camera in m";
const TARGET: &str = "the point in the middle of the picture in m";

fn cut(place: &Place, domain: &Domain) -> Result<CameraCut, Error> {
    let table = place.clone().table(&CUT)?;
    let axis = table.required("axis", "axis = \"z\"")?;
    let axis = axis.choice(&[("x", 0), ("y", 1), ("z", 2)])?;
    let at_place = table.required("at", "at = 0.5, in m")?;
    let at = at_place.number("where the plane crosses the axis in m")?;
    let end = domain.size[axis];
    at_place.ensure(
        at > 0.0 && at < end,
        format!("is {at}, outside the domain"),
        format!("write a number between 0 and {end}"),
    )?;
    Ok(CameraCut { axis, at })
}

fn opening(place: &Place) -> Result<f64, Error> {
    let fov = place.positive("the vertical opening in degrees")?;
    place.within(
        fov,
        ..=150.0,
        format!("is {fov}"),
        "use at most 150 degrees; 35 is usual",
    )?;
    Ok(fov)
}

/// That a camera looks somewhere, and not along its up; `when` ends the sentence.
fn ensure_view(place: &Place, pose: &CameraKeyframe, up: DVec3, when: &str) -> Result<(), Error> {
    let ahead = (pose.target - pose.eye).try_normalize();
    place.ensure(
        ahead.is_some(),
        format!("is the target itself{when}"),
        "move it away from the target",
    )?;
    place.ensure(
        ahead.is_some_and(|ahead| ahead.dot(up).abs() < 1.0 - 1e-9),
        format!("looks along the camera's up{when}"),
        "move it, or set camera.up to another direction",
    )
}

/// Reads the keyframes into the camera, and says where each was written.
fn path<'a>(place: &Place<'a>, camera: &mut Camera) -> Result<Vec<Place<'a>>, Error> {
    let places = place.list()?;
    place.ensure(
        !places.is_empty(),
        "has no entry",
        "write keyframes = [{ t = 0, eye = [3, 2, 4] }, { t = 2, eye = [0, 2, 5] }]",
    )?;
    for entry in &places {
        let table = entry.clone().table(&KEYFRAME)?;
        let time_place = table.required("t", "t = 0.5, in s")?;
        let time = time_place.number("the time of the keyframe in s")?;
        let before = camera.keyframes.last().map(|keyframe| keyframe.time);
        time_place.ensure(
            before.is_none_or(|before| time > before),
            format!("{time} s does not come after the time before it"),
            "write the keyframes in the order of their times, each time once",
        )?;
        camera.keyframes.push(CameraKeyframe {
            time,
            eye: table
                .required("eye", "eye = [3, 2, 4], in m")?
                .vector(EYE)?,
            target: match table.get("target") {
                Some(place) => place.vector(TARGET)?,
                None => camera.target,
            },
            fov: match table.get("fov") {
                Some(place) => opening(&place)?,
                None => camera.fov,
            },
        });
    }
    Ok(places)
}

impl Camera {
    /// Where it is at a time (s), and where it looks: of the keyframes, by cubic Hermite polynomials between neighbours whose
    /// slopes are those from the keyframe before to the one after (Catmull and Rom 1974), of the first and the last to their
    /// neighbour; before and after, it rests. The opening stays between the least and the largest.
    pub fn pose(&self, time: f64) -> CameraKeyframe {
        let resting = CameraKeyframe {
            time,
            eye: self.eye,
            target: self.target,
            fov: self.fov,
        };
        let path = &self.keyframes;
        let (Some(first), Some(last)) = (path.first(), path.last()) else {
            return resting;
        };
        if time <= first.time {
            return CameraKeyframe { time, ..*first };
        }
        if time >= last.time {
            return CameraKeyframe { time, ..*last };
        }
        let next = path.partition_point(|keyframe| keyframe.time <= time);
        let here = next - 1;
        let span = path[next].time - path[here].time;
        let t = (time - path[here].time) / span;
        let along = |value: &dyn Fn(&CameraKeyframe) -> DVec3| {
            let slope = |at: usize| {
                let (low, high) = (at.max(1) - 1, (at + 1).min(path.len() - 1));
                let rise = value(&path[high]) - value(&path[low]);
                rise * (span / (path[high].time - path[low].time))
            };
            let (from, to) = (value(&path[here]), value(&path[next]));
            let (leaving, arriving) = (slope(here), slope(next));
            let rest = 3.0 * (to - from) - 2.0 * leaving - arriving;
            from + t * (leaving + t * (rest + t * (2.0 * (from - to) + leaving + arriving)))
        };
        let openings = path.iter().map(|keyframe| keyframe.fov);
        let least = openings.clone().fold(f64::INFINITY, f64::min);
        let largest = openings.fold(0.0, f64::max);
        CameraKeyframe {
            time,
            eye: along(&|keyframe| keyframe.eye),
            target: along(&|keyframe| keyframe.target),
            fov: along(&|keyframe| DVec3::splat(keyframe.fov))
                .x
                .clamp(least, largest),
        }
    }

    /// Three-quarter view of the whole domain from slightly above. Up is the axis against gravity's largest component,
    /// +y without gravity.
    pub fn looking_at(domain: &Domain) -> Camera {
        let gravity = domain.gravity;
        let largest = gravity.abs().max_position();
        let up = if gravity == DVec3::ZERO {
            DVec3::Y
        } else {
            DVec3::AXES[largest] * -gravity[largest].signum()
        };
        let target = 0.5 * domain.size;
        let mut camera = Camera {
            eye: target,
            target,
            up,
            fov: 35.0,
            size: [1280, 720],
            keyframes: Vec::new(),
            cut: None,
        };
        camera.step_back(domain);
        camera
    }

    /// Puts the eye so far from the target that the domain's eight corners are in the picture, with 5 % to spare.
    fn step_back(&mut self, domain: &Domain) {
        // The picture's depth axis when seen from the front: y up looks along -z with x to the right, z up along y.
        let front = if self.up.z.abs() > 0.5 {
            -DVec3::Y
        } else {
            DVec3::Z
        };
        let front = front
            .reject_from(self.up)
            .try_normalize()
            .unwrap_or_else(|| self.up.any_orthonormal_vector());
        let side = self.up.cross(front);
        let back = (front + 0.5 * side + 0.5 * self.up).normalize();
        let right = self.up.cross(back).normalize();
        let top = back.cross(right);
        let half_height = (0.5 * self.fov.to_radians()).tan();
        let half_width = half_height * self.size[0] as f64 / self.size[1] as f64;
        let needed = corners(domain.size).into_iter().map(|corner| {
            let x = corner - self.target;
            x.dot(back) + (x.dot(right).abs() / half_width).max(x.dot(top).abs() / half_height)
        });
        let distance = 1.05 * needed.fold(0.0, f64::max);
        self.eye = self.target + distance * back;
    }
}
