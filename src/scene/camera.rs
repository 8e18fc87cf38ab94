//! The camera, and where it stands when the scene does not say.

use glam::DVec3;

use super::document::{Keys, Table};
use super::shape::corners;
use super::{Camera, Domain};
use crate::error::Error;

const CAMERA: Keys = Keys {
    valid: &["eye", "target", "up", "fov", "size"],
    later: &[],
};

/// The camera of a scene.
pub(super) fn camera(root: &Table, domain: &Domain) -> Result<Camera, Error> {
    let mut camera = Camera::looking_at(domain);
    let Some(place) = root.get("camera") else {
        return Ok(camera);
    };
    let table = place.table(&CAMERA)?;
    if let Some(place) = table.get("up") {
        camera.up = place.direction("the direction that is up in the picture")?;
    }
    if let Some(place) = table.get("fov") {
        camera.fov = place.positive("the vertical opening in degrees")?;
        place.within(
            camera.fov,
            ..=150.0,
            format!("is {}", camera.fov),
            "use at most 150 degrees; 35 is usual",
        )?;
    }
    if let Some(place) = table.get("size") {
        camera.size = place.counts("the width and height of the picture in pixels", 16, 8192)?;
    }
    if let Some(place) = table.get("target") {
        camera.target = place.vector("the point in the middle of the picture in m")?;
    }
    match table.get("eye") {
        Some(place) => {
            camera.eye = place.vector("the position of the camera in m")?;
            let ahead = (camera.target - camera.eye).try_normalize();
            place.ensure(
                ahead.is_some(),
                "is the target itself",
                "move it away from the target",
            )?;
            let parallel = ahead.is_some_and(|ahead| ahead.dot(camera.up).abs() > 1.0 - 1e-9);
            place.ensure(
                !parallel,
                "looks along the camera's up",
                "move it, or set camera.up to another direction",
            )?;
        }
        None => camera.step_back(domain),
    }
    Ok(camera)
}

impl Camera {
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
