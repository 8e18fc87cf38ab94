//! The camera, its path, and its default position.

use glam::DVec3;

use super::document::{Keys, Place, Table};
use super::shape::corners;
use super::{Camera, CameraCut, CameraKeyframe, Domain, Time};
use crate::error::Error;

/// Sides of pictures, pixels.
pub const PICTURE_SIDES: std::ops::RangeInclusive<usize> = 16..=8192;

const CAMERA: Keys = Keys::new(&["eye", "target", "up", "fov", "size", "keyframes", "cut"]);
const CUT: Keys = Keys::new(&["axis", "at"]);
const KEYFRAME: Keys = Keys::new(&["t", "eye", "target", "fov"]);

pub(super) fn camera(root: &Table, domain: &Domain, time: &Time) -> Result<Camera, Error> {
    let mut camera = Camera::looking_at(domain);
    let Some(place) = root.get("camera") else {
        return Ok(camera);
    };
    let table = place.table(&CAMERA)?;
    camera.up = table.optional("up", camera.up, |place| place.direction("the direction that is up in the picture"))?;
    camera.fov = table.optional("fov", camera.fov, field_of_view)?;
    camera.size = table.optional("size", camera.size, |place| {
        place.counts(
            "the width and height of the picture in pixels",
            *PICTURE_SIDES.start() as u64,
            *PICTURE_SIDES.end() as u64,
        )
    })?;
    camera.target = table.optional("target", camera.target, |place| place.vector(TARGET))?;
    camera.cut = table.optional("cut", None, |place| cut(&place, domain).map(Some))?;
    let keyframes = table.get("keyframes");
    match table.get("eye") {
        Some(place) => {
            place.ensure(
                keyframes.is_none(),
                "conflicts with keyframes, which set the position too",
                "remove one of the two",
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
    let at = at_place.number("the coordinate of the plane in m")?;
    let end = domain.size[axis];
    at_place.ensure(
        at > 0.0 && at < end,
        format!("is {at}, outside the domain"),
        format!("write a number between 0 and {end}"),
    )?;
    Ok(CameraCut { axis, at })
}

fn field_of_view(place: Place) -> Result<f64, Error> {
    let what = "the vertical field of view in degrees";
    place.positive_within(what, ..=150.0, "use at most 150 degrees; 35 is usual")
}

/// Refuses a camera at its target, or one that looks along its up vector; `when` ends the sentence.
fn ensure_view(place: &Place, pose: &CameraKeyframe, up: DVec3, when: &str) -> Result<(), Error> {
    let ahead = (pose.target - pose.eye).try_normalize();
    place.ensure(ahead.is_some(), format!("is the target itself{when}"), "move it away from the target")?;
    place.ensure(
        ahead.is_some_and(|ahead| ahead.dot(up).abs() < 1.0 - 1e-9),
        format!("looks along the camera's up{when}"),
        "move it, or set camera.up to another direction",
    )
}

/// Reads the keyframes into the camera and returns their places.
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
            format!("{time} s is not later than the keyframe before"),
            "write the keyframes in ascending order of time",
        )?;
        camera.keyframes.push(CameraKeyframe {
            time,
            eye: table.required("eye", "eye = [3, 2, 4], in m")?.vector(EYE)?,
            target: table.optional("target", camera.target, |place| place.vector(TARGET))?,
            fov: table.optional("fov", camera.fov, field_of_view)?,
        });
    }
    Ok(places)
}

impl Camera {
    /// Position, target and field of view at a time (s).
    ///
    /// Between keyframes: cubic Hermite polynomials with the slope from the previous to the next keyframe (Catmull and Rom 1974),
    /// one-sided at both ends. The field of view is clamped to the range of the keyframes.
    pub fn pose(&self, time: f64) -> CameraKeyframe {
        let resting = CameraKeyframe { time, eye: self.eye, target: self.target, fov: self.fov };
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
            fov: along(&|keyframe| DVec3::splat(keyframe.fov)).x.clamp(least, largest),
        }
    }

    /// Three-quarter view of the whole domain from slightly above. Up is the axis against gravity's largest component, or +y
    /// without gravity.
    pub fn looking_at(domain: &Domain) -> Camera {
        let gravity = domain.gravity;
        let largest = gravity.abs().max_position();
        let up = if gravity == DVec3::ZERO { DVec3::Y } else { DVec3::AXES[largest] * -gravity[largest].signum() };
        let target = 0.5 * domain.size;
        let mut camera =
            Camera { eye: target, target, up, fov: 35.0, size: [1280, 720], keyframes: Vec::new(), cut: None };
        camera.step_back(domain);
        camera
    }

    /// Moves the eye back until all corners of the domain are in the picture, with a margin of 5 %.
    fn step_back(&mut self, domain: &Domain) {
        // From the front: with y up the camera looks along -z, with z up along y.
        let front = if self.up.z.abs() > 0.5 { -DVec3::Y } else { DVec3::Z };
        let front = front.reject_from(self.up).try_normalize().unwrap_or_else(|| self.up.any_orthonormal_vector());
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
