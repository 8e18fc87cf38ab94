//! Shapes, placements and keyframes: how they are written, and what can be told of them without a mesh file.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};

use super::document::{Keys, Place, Table};
use super::{Keyframe, Placement, Shape, SolitaryWave};
use crate::error::Error;

const PLACEMENT: Keys = Keys {
    valid: &["at", "translate", "rotate", "scale"],
    absent: &[],
};
const ROTATE: Keys = Keys {
    valid: &["axis", "degrees"],
    absent: &[],
};
const KEYFRAME: Keys = Keys {
    valid: &["t", "translate", "rotate"],
    absent: &[],
};
const BOX: Keys = Keys {
    valid: &["min", "max"],
    absent: &[],
};
const SPHERE: Keys = Keys {
    valid: &["centre", "radius"],
    absent: &[],
};
const CYLINDER: Keys = Keys {
    valid: &["base", "axis", "radius", "height"],
    absent: &[],
};
const HALF_SPACE: Keys = Keys {
    valid: &["point", "normal"],
    absent: &[],
};
const WAVE: Keys = Keys {
    valid: &["level", "amplitude", "wave_number", "phase"],
    absent: &[],
};
const SOLITARY: Keys = Keys {
    valid: &["depth", "height", "crest", "direction"],
    absent: &[],
};
const MESH: Keys = Keys {
    valid: &["file", "units"],
    absent: &[],
};
/// Length units of mesh files, m.
const UNITS: [(&str, f64); 4] = [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254)];

/// Highest solitary wave, over the depth: beyond, theory of third order is not the wave that stays as it is.
const HIGHEST_SOLITARY: f64 = 0.6;

/// Of a solitary wave, m: its speed grows with it.
const MAX_DEPTH: f64 = 1e6;

/// The shape under the key `kind`; mesh files are relative to the folder of the scene's `file`.
pub(super) fn shape(kind: &str, place: Place, file: &Path) -> Result<Shape, Error> {
    Ok(match kind {
        "box" => {
            let table = place.clone().table(&BOX)?;
            let min_place = table.required("min", "min = [0, 0, 0], the low corner in m")?;
            let min = min_place.vector("the low corner in m")?;
            let max_place = table.required("max", "max = [1, 1, 1], the high corner in m")?;
            let max = max_place.vector("the high corner in m")?;
            // A corner that an override moved is at fault.
            let mut corners = [&min_place, &max_place].into_iter();
            let moved = corners.find(|corner| corner.is_override());
            for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
                moved.unwrap_or(&place).ensure(
                    max[axis] > min[axis],
                    format!(
                        "the box has no volume: along {name} it goes from {} to {}",
                        min[axis], max[axis]
                    ),
                    "make every number of max larger than that of min",
                )?;
            }
            Shape::Box { min, max }
        }
        "sphere" => {
            let table = place.table(&SPHERE)?;
            Shape::Sphere {
                centre: table
                    .required("centre", "centre = [0.5, 0.5, 0.5], in m")?
                    .vector("the centre in m")?,
                radius: table
                    .required("radius", "radius = 0.1, in m")?
                    .positive("the radius in m")?,
            }
        }
        "cylinder" => {
            let table = place.table(&CYLINDER)?;
            let axis = table.required("axis", "axis = [0, 1, 0], from the base")?;
            Shape::Cylinder {
                base: table
                    .required("base", "base = [0.5, 0, 0.5], its centre in m")?
                    .vector("the centre of the base in m")?,
                axis: axis.direction("the direction from the base")?,
                radius: table
                    .required("radius", "radius = 0.1, in m")?
                    .positive("the radius in m")?,
                height: table
                    .required("height", "height = 0.3, in m")?
                    .positive("the height along the axis in m")?,
            }
        }
        "half_space" => {
            let table = place.table(&HALF_SPACE)?;
            let normal = table.required("normal", "normal = [0, 1, 0], out of the half space")?;
            Shape::HalfSpace {
                point: table
                    .required("point", "point = [0, 0.5, 0], in m")?
                    .vector("a point of the plane in m")?,
                normal: normal.direction("the direction out of the half space")?,
            }
        }
        "wave" => {
            let table = place.table(&WAVE)?;
            let wave_number = table.required(
                "wave_number",
                "wave_number = [3.14159, 0], along x and z in rad/m",
            )?;
            Shape::Wave {
                level: table
                    .required("level", "level = 0.5, in m")?
                    .number("the mean height in m")?,
                amplitude: table
                    .required("amplitude", "amplitude = 0.05, in m")?
                    .number("the amplitude in m")?,
                wave_number: wave_number.numbers("the wave numbers along x and z in rad/m")?,
                phase: table
                    .get("phase")
                    .map_or(Ok(0.0), |place| place.number("the phase in rad"))?,
            }
        }
        "mesh" => {
            let table = place.table(&MESH)?;
            let name_place =
                table.required("file", "file = \"body.obj\", relative to the scene")?;
            Shape::Mesh {
                file: existing_file(
                    &name_place,
                    file,
                    &["obj", "stl", "ply"],
                    "the name of an OBJ, STL or PLY file",
                    "use a closed triangle mesh as .obj, .stl or .ply",
                )?,
                unit: unit(&table)?,
            }
        }
        _ => unreachable!("a shape key that no table lists"),
    })
}

/// A solitary wave under this gravity, m/s^2.
pub(super) fn solitary(place: Place, gravity: DVec3) -> Result<Shape, Error> {
    let table = place.clone().table(&SOLITARY)?;
    let depth_place = table.required("depth", "depth = 0.3, of the water at rest in m")?;
    let depth = depth_place.positive("the depth of the water at rest in m")?;
    depth_place.within(
        depth,
        ..=MAX_DEPTH,
        format!("is {depth:e}"),
        format!("write at most {MAX_DEPTH:e} m, as large as a domain may be"),
    )?;
    let height_place = table.required("height", "height = 0.06, of the crest in m")?;
    let height = height_place.positive("the height of the crest above the water at rest in m")?;
    height_place.ensure(
        height <= HIGHEST_SOLITARY * depth,
        format!("is {height}, {:.2} of the depth", height / depth),
        format!(
            "write at most {HIGHEST_SOLITARY} of the depth, {} m: higher ones are not known well, and break from 0.83 on",
            HIGHEST_SOLITARY * depth
        ),
    )?;
    let crest = table.required(
        "crest",
        "crest = [1, 0], x and z of a point of the crest in m",
    )?;
    let way = table.required(
        "direction",
        "direction = [1, 0], where it goes along x and z",
    )?;
    let [x, z] = way.numbers("where it goes along x and z")?;
    let length = f64::hypot(x, z);
    way.ensure(
        length.is_normal(),
        format!("is [{x}, {z}], which has no direction"),
        "write where it goes along x and z, such as [1, 0]",
    )?;
    place.ensure(
        gravity.y < 0.0 && gravity.x == 0.0 && gravity.z == 0.0,
        format!(
            "runs over a level floor, and gravity is [{}, {}, {}]",
            gravity.x, gravity.y, gravity.z
        ),
        "let domain.gravity point along -y, such as [0, -9.81, 0]",
    )?;
    Ok(Shape::Solitary(SolitaryWave {
        depth,
        height,
        crest: crest.numbers("x and z of a point of the crest in m")?,
        direction: [x / length, z / length],
        gravity: -gravity.y,
    }))
}

/// The file with the name at `place`, resolved against the folder of the scene's `file`. `what` names it; its extension must be
/// among `kinds`, else `cure` says what would be right.
pub(super) fn existing_file(
    place: &Place,
    file: &Path,
    kinds: &[&str],
    what: &str,
    cure: &str,
) -> Result<PathBuf, Error> {
    let name = place.text(what)?;
    let kind = Path::new(name)
        .extension()
        .map(|kind| kind.to_ascii_lowercase());
    let known = kind.is_some_and(|kind| kinds.iter().any(|known| kind == *known));
    let problem = format!("`{name}` is not a kind of mesh that is read");
    place.ensure(known, problem, cure)?;
    let resolved = file.parent().unwrap_or(Path::new("")).join(name);
    let problem = match resolved.is_dir() {
        true => format!("{} is a folder", resolved.display()),
        false => format!("there is no file {}", resolved.display()),
    };
    place.ensure(
        place.is_exemplar() || resolved.is_file(),
        problem,
        "give the path of the mesh relative to the scene's folder",
    )?;
    Ok(resolved)
}

/// Length unit of the mesh file that a table names, m.
pub(super) fn unit(table: &Table) -> Result<f64, Error> {
    table
        .get("units")
        .map_or(Ok(1.0), |place| place.choice(&UNITS))
}

/// Where a shape, or the mesh of a solid, with this centre (m) is put; `None`: a file, whose centre is not known yet.
pub(super) fn placement(table: &Table, centre: Option<DVec3>) -> Result<Placement, Error> {
    let Some(place) = table.get("placement") else {
        return Ok(Placement::default());
    };
    let table = place.table(&PLACEMENT)?;
    let mut placement = Placement::default();
    if let Some(place) = table.get("at") {
        placement.at = Some(place.vector("the place of the centre in m")?);
        place.ensure(
            table.get("translate").is_none(),
            "and `translate` both say where the shape is put",
            "keep one: `at` is the place of its centre, `translate` moves it from where it is",
        )?;
    }
    if let Some(place) = table.get("translate") {
        placement.translate = place.vector("a translation in m")?;
    }
    if let Some(place) = table.get("rotate") {
        let (axis, angle) = turn(place)?;
        placement.rotate = DMat3::from_axis_angle(axis, angle);
    }
    if let Some(place) = table.get("scale") {
        placement.scale = place.positive("one factor for all axes")?;
        place.ensure(
            (1e-9..=1e9).contains(&placement.scale),
            "is no factor between units of length",
            "write a factor from 1e-9 to 1e9",
        )?;
    }
    Ok(match centre {
        Some(centre) => placement.about(centre),
        None => placement,
    })
}

/// The axis (a unit vector) and the angle (rad) of a rotation.
pub(super) fn turn(place: Place) -> Result<(DVec3, f64), Error> {
    let table = place.table(&ROTATE)?;
    let axis = table
        .required("axis", "axis = [0, 0, 1]")?
        .direction("the axis of rotation")?;
    let degrees = table
        .required("degrees", "degrees = 30")?
        .number("the angle in degrees")?;
    Ok((axis, degrees.to_radians()))
}

/// The keyframes of a script or of an obstacle, ascending in time.
pub(super) fn keyframes(table: &Table) -> Result<Vec<Keyframe>, Error> {
    let example = "keyframes = [{ t = 0 }, { t = 1, translate = [0, 0.1, 0] }]";
    let places = table.required("keyframes", example)?;
    let mut keyframes: Vec<Keyframe> = Vec::new();
    for place in places.list()? {
        let table = place.table(&KEYFRAME)?;
        let time_place = table.required("t", "t = 0.5, in s")?;
        let time = time_place.number("the time of the keyframe in s")?;
        time_place.ensure(
            time >= 0.0,
            format!("is {time}, before the start"),
            "write a time from 0 on",
        )?;
        if let Some(last) = keyframes.last() {
            time_place.ensure(
                time > last.time,
                format!(
                    "{time} s does not come after {} s, the time before it",
                    last.time
                ),
                "write the keyframes in the order of their times, each time once",
            )?;
        }
        let translate = match table.get("translate") {
            Some(place) => place.vector("a translation from rest in m")?,
            None => DVec3::ZERO,
        };
        let (axis, angle) = match table.get("rotate") {
            Some(place) => turn(place)?,
            None => (DVec3::Y, 0.0),
        };
        keyframes.push(Keyframe {
            time,
            translate,
            axis,
            angle,
        });
    }
    places.ensure(
        !keyframes.is_empty(),
        "has no entry",
        format!("write {example}"),
    )?;
    Ok(keyframes)
}

impl Shape {
    /// What it is turned and scaled about: the middle of a box, ball or cylinder. `None` for a mesh, whose centre is that
    /// of its bounding box and known only to the reader of its file, and for half spaces and waves of both kinds, which are not placed.
    pub fn centre(&self) -> Option<DVec3> {
        match self {
            Shape::Box { min, max } => Some(0.5 * (min + max)),
            Shape::Sphere { centre, .. } => Some(*centre),
            Shape::Cylinder {
                base, axis, height, ..
            } => Some(base + 0.5 * height * axis),
            Shape::HalfSpace { .. }
            | Shape::Wave { .. }
            | Shape::Solitary(_)
            | Shape::Mesh { .. } => None,
        }
    }

    /// Area of the shadow that a box, ball or cylinder casts along a unit vector, m^2; 0 of other shapes.
    pub(crate) fn projected_area(&self, way: DVec3) -> f64 {
        match *self {
            Shape::Box { min, max } => {
                let [x, y, z] = (max - min).to_array();
                way.abs().dot(DVec3::new(y * z, z * x, x * y))
            }
            Shape::Sphere { radius, .. } => std::f64::consts::PI * radius * radius,
            Shape::Cylinder {
                axis,
                radius,
                height,
                ..
            } => {
                let along = way.dot(axis).abs();
                let across = way.cross(axis).length();
                radius * (std::f64::consts::PI * radius * along + 2.0 * height * across)
            }
            _ => 0.0,
        }
    }

    /// Whether a box, ball or cylinder lies in the box from the origin to `size`, to rounding.
    pub(crate) fn lies_in(&self, size: DVec3) -> bool {
        let (centre, half) = match *self {
            Shape::Box { min, max } => (0.5 * (min + max), 0.5 * (max - min)),
            Shape::Sphere { centre, radius } => (centre, DVec3::splat(radius)),
            Shape::Cylinder {
                base,
                axis,
                radius,
                height,
            } => {
                let rim = (DVec3::ONE - axis * axis).max(DVec3::ZERO);
                let rim = radius * DVec3::new(rim.x.sqrt(), rim.y.sqrt(), rim.z.sqrt());
                (base + 0.5 * height * axis, 0.5 * height * axis.abs() + rim)
            }
            _ => return false,
        };
        let slack = 1e-9 * size.max_element();
        let (low, high) = (centre - half, centre + half - size);
        low.min_element() >= -slack && high.max_element() <= slack
    }

    /// Whether some of it lies in the box from the origin to `size`, judged by bounding boxes; true for meshes and solitary waves.
    pub(super) fn reaches(&self, placement: &Placement, size: DVec3) -> bool {
        let half_extent = match self {
            Shape::Box { min, max } => {
                let half = 0.5 * (max - min);
                let turned =
                    DMat3::from_cols_array(&placement.rotate.to_cols_array().map(f64::abs));
                turned * half
            }
            Shape::Sphere { centre, radius } => {
                let centre = centre + placement.translate;
                let nearest = centre.clamp(DVec3::ZERO, size);
                return nearest.distance(centre) < radius * placement.scale;
            }
            Shape::Cylinder {
                axis,
                radius,
                height,
                ..
            } => {
                let axis = placement.rotate * axis;
                let rim = (DVec3::ONE - axis * axis).max(DVec3::ZERO);
                0.5 * height * axis.abs()
                    + *radius * DVec3::new(rim.x.sqrt(), rim.y.sqrt(), rim.z.sqrt())
            }
            Shape::HalfSpace { point, normal } => {
                return corners(size)
                    .iter()
                    .any(|corner| (corner - point).dot(*normal) < 0.0);
            }
            Shape::Wave {
                level, amplitude, ..
            } => return level + amplitude.abs() > 0.0,
            Shape::Solitary(_) | Shape::Mesh { .. } => return true,
        };
        let centre =
            self.centre().expect("boxes and cylinders have a centre") + placement.translate;
        let half_extent = half_extent * placement.scale;
        (centre + half_extent).cmpgt(DVec3::ZERO).all() && (centre - half_extent).cmplt(size).all()
    }

    /// Whether the whole box from the origin to `size` lies in it. Box, ball and cylinder are convex, so the corners tell;
    /// false for meshes.
    pub(super) fn holds_box(&self, placement: &Placement, size: DVec3) -> bool {
        let Some(centre) = self.centre() else {
            return false;
        };
        corners(size).into_iter().all(|corner| {
            // From the middle of the shape, in its own directions and size.
            let x = placement.rotate.transpose() * (corner - placement.translate - centre)
                / placement.scale;
            match self {
                Shape::Box { min, max } => x.abs().cmple(0.5 * (max - min)).all(),
                Shape::Sphere { radius, .. } => x.length() <= *radius,
                Shape::Cylinder {
                    axis,
                    radius,
                    height,
                    ..
                } => {
                    x.dot(*axis).abs() <= 0.5 * height
                        && x.reject_from_normalized(*axis).length() <= *radius
                }
                Shape::HalfSpace { .. }
                | Shape::Wave { .. }
                | Shape::Solitary(_)
                | Shape::Mesh { .. } => false,
            }
        })
    }
}

/// The corners of the box from the origin to `size`.
pub(super) fn corners(size: DVec3) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        size * DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2 & 1) as f64)
    })
}
