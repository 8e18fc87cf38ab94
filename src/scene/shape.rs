//! Shapes, placements and keyframes: their keys, and checks that need no mesh file.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};

use super::document::{Keys, Place, Table};
use super::read::{bounded, list};
use super::{Keyframe, MeshFile, Motion, Placement, Shape, SolitaryWave, VectorKeyframe};
use crate::error::Error;

const PLACEMENT: Keys = Keys::new(&["at", "translate", "rotate", "scale"]);
const ROTATE: Keys = Keys::new(&["axis", "degrees"]);
const KEYFRAME: Keys = Keys::new(&["t", "translate", "rotate"]);
const BOX: Keys = Keys::new(&["min", "max"]);
const SPHERE: Keys = Keys::new(&["centre", "radius"]);
const CYLINDER: Keys = Keys::new(&["base", "axis", "radius", "height"]);
const HALF_SPACE: Keys = Keys::new(&["point", "normal"]);
const WAVE: Keys = Keys::new(&["level", "amplitude", "wave_number", "phase"]);
const SOLITARY: Keys = Keys::new(&["depth", "height", "crest", "direction"]);
const MESH: Keys = Keys::new(&["file", "units"]);
/// Length units of mesh files, m.
const UNITS: [(&str, f64); 4] = [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254)];

/// Greatest height of a solitary wave over its depth. Higher waves of third-order theory change their shape.
const MAX_SOLITARY: f64 = 0.6;

/// Greatest depth of a solitary wave, m. Its speed grows with the depth.
const MAX_DEPTH: f64 = 1e6;

/// The shape under the key `kind`; mesh files are relative to the folder of the scene's `file`.
pub(super) fn shape(kind: &str, place: Place, file: &Path) -> Result<Shape, Error> {
    Ok(match kind {
        "box" => cuboid(place)?,
        "sphere" => {
            let table = place.table(&SPHERE)?;
            Shape::Sphere {
                centre: table.required("centre", "centre = [0.5, 0.5, 0.5], in m")?.vector("the centre in m")?,
                radius: table.required("radius", "radius = 0.1, in m")?.positive("the radius in m")?,
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
                radius: table.required("radius", "radius = 0.1, in m")?.positive("the radius in m")?,
                height: table.required("height", "height = 0.3, in m")?.positive("the height along the axis in m")?,
            }
        }
        "half_space" => {
            let table = place.table(&HALF_SPACE)?;
            let normal = table.required("normal", "normal = [0, 1, 0], out of the half space")?;
            Shape::HalfSpace {
                point: table.required("point", "point = [0, 0.5, 0], in m")?.vector("a point of the plane in m")?,
                normal: normal.direction("the direction out of the half space")?,
            }
        }
        "wave" => {
            let table = place.table(&WAVE)?;
            let wave_number = table.required("wave_number", "wave_number = [3.14159, 0], along x and z in rad/m")?;
            Shape::Wave {
                level: table.required("level", "level = 0.5, in m")?.number("the mean height in m")?,
                amplitude: table.required("amplitude", "amplitude = 0.05, in m")?.number("the amplitude in m")?,
                wave_number: wave_number.numbers("the wave numbers along x and z in rad/m")?,
                phase: table.get("phase").map_or(Ok(0.0), |place| place.number("the phase in rad"))?,
            }
        }
        "mesh" => {
            let (file, unit) = surface_file(&place.table(&MESH)?, file)?;
            Shape::Mesh { file, unit }
        }
        _ => unreachable!("a shape key that no table lists"),
    })
}

fn cuboid(place: Place) -> Result<Shape, Error> {
    let table = place.clone().table(&BOX)?;
    let min_place = table.required("min", "min = [0, 0, 0], the low corner in m")?;
    let min = min_place.vector("the low corner in m")?;
    let max_place = table.required("max", "max = [1, 1, 1], the high corner in m")?;
    let max = max_place.vector("the high corner in m")?;
    // Blames a corner that an override has changed.
    let mut corners = [&min_place, &max_place].into_iter();
    let moved = corners.find(|corner| corner.is_override());
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        moved.unwrap_or(&place).ensure(
            max[axis] > min[axis],
            format!("the box has no volume: along {name} it extends from {} to {}", min[axis], max[axis]),
            "make every number of max larger than that of min",
        )?;
    }
    Ok(Shape::Box { min, max })
}

/// The closed surface that a table names: its file and length unit, m.
pub(super) fn surface_file(table: &Table, scene: &Path) -> Result<(MeshFile, f64), Error> {
    let place = table.required("file", "file = \"body.obj\", relative to the scene")?;
    let kinds = ["obj", "stl", "ply", "glb", "gltf"];
    let what = "the name of an OBJ, STL, PLY or glTF file";
    let cure = "use a closed triangle mesh as .obj, .stl, .ply or .glb";
    let file = mesh_file(&place, scene, &kinds, what, cure)?;
    Ok((file, unit(table)?))
}

/// An error unless a shape is `inside` the domain, at least in part.
pub(super) fn ensure_in_domain(place: &Place, inside: bool, size: DVec3) -> Result<(), Error> {
    place.ensure(
        inside,
        format!("lies outside the domain, which extends from the origin to {} m", list(size.to_array())),
        "move it so that a part lies inside",
    )
}

/// A solitary wave under this gravity, m/s^2.
pub(super) fn solitary(place: Place, gravity: DVec3) -> Result<Shape, Error> {
    let table = place.clone().table(&SOLITARY)?;
    let depth_place = table.required("depth", "depth = 0.3, of the water at rest in m")?;
    let depth = depth_place.positive_within(
        "the depth of the water at rest in m",
        ..=MAX_DEPTH,
        format!("write at most {MAX_DEPTH:e} m, the limit of a domain"),
    )?;
    let height_place = table.required("height", "height = 0.06, of the crest in m")?;
    let height = height_place.positive("the height of the crest above the water at rest in m")?;
    height_place.ensure(
        height <= MAX_SOLITARY * depth,
        format!("is {height}, {:.2} of the depth", height / depth),
        format!(
            "write at most {MAX_SOLITARY} of the depth, {} m: the theory of higher waves is inaccurate, and they break from 0.83 on",
            MAX_SOLITARY * depth
        ),
    )?;
    let crest = table.required("crest", "crest = [1, 0], x and z of a point of the crest in m")?;
    let direction = table.required("direction", "direction = [1, 0], of propagation along x and z")?;
    let [x, z] = direction.numbers("the direction of propagation along x and z")?;
    let length = f64::hypot(x, z);
    direction.ensure(
        length.is_normal(),
        format!("is [{x}, {z}], which has no direction"),
        "write the direction of propagation along x and z, such as [1, 0]",
    )?;
    place.ensure(
        gravity.y < 0.0 && gravity.x == 0.0 && gravity.z == 0.0,
        format!("needs a level floor, and gravity is [{}, {}, {}]", gravity.x, gravity.y, gravity.z),
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

/// The existing file with the name at `place`, relative to the folder of the `scene` file, with an extension among `kinds`.
pub(super) fn mesh_file(
    place: &Place,
    scene: &Path,
    kinds: &[&str],
    what: &str,
    cure: &str,
) -> Result<MeshFile, Error> {
    let name = place.text(what)?;
    let kind = Path::new(name).extension().map(|kind| kind.to_ascii_lowercase());
    let known = kind.is_some_and(|kind| kinds.iter().any(|known| kind == *known));
    let problem = format!("`{name}` is not a supported mesh format");
    place.ensure(known, problem, cure)?;
    let resolved: PathBuf = scene.parent().unwrap_or(Path::new("")).join(name);
    let problem = match resolved.is_dir() {
        true => format!("{} is a folder", resolved.display()),
        false => format!("there is no file {}", resolved.display()),
    };
    place.ensure(
        place.is_exemplar() || resolved.is_file(),
        problem,
        "give the path of the mesh relative to the scene's folder",
    )?;
    Ok(place.mesh_file(resolved))
}

/// Length unit of the mesh file that a table names, m.
pub(super) fn unit(table: &Table) -> Result<f64, Error> {
    table.optional("units", 1.0, |place| place.choice(&UNITS))
}

/// Placement of a shape with this centre (m); `None` for a mesh file, whose centre is unknown before it is parsed.
pub(super) fn placement(table: &Table, centre: Option<DVec3>) -> Result<Placement, Error> {
    let Some(place) = table.get("placement") else {
        return Ok(Placement::default());
    };
    let table = place.table(&PLACEMENT)?;
    let mut placement = Placement::default();
    if let Some(place) = table.get("at") {
        placement.at = Some(place.vector("the position of the centre in m")?);
        place.ensure(
            table.get("translate").is_none(),
            "conflicts with `translate`: both position the shape",
            "keep one: `at` is the position of its centre, `translate` a displacement",
        )?;
    }
    if let Some(place) = table.get("translate") {
        placement.translate = place.vector("a translation in m")?;
    }
    if let Some(place) = table.get("rotate") {
        let (axis, angle) = rotation(place)?;
        placement.rotate = DMat3::from_axis_angle(axis, angle);
    }
    if let Some(place) = table.get("scale") {
        placement.scale = place.positive("one factor for all axes")?;
        place.ensure(
            (1e-9..=1e9).contains(&placement.scale),
            "is no ratio of length units",
            "write a factor from 1e-9 to 1e9",
        )?;
    }
    Ok(match centre {
        Some(centre) => placement.about(centre),
        None => placement,
    })
}

/// The axis (a unit vector) and the angle (rad) of a rotation.
fn rotation(place: Place) -> Result<(DVec3, f64), Error> {
    let table = place.table(&ROTATE)?;
    let axis = table.required("axis", "axis = [0, 0, 1]")?.direction("the axis of rotation")?;
    let degrees = table.required("degrees", "degrees = 30")?.number("the angle in degrees")?;
    Ok((axis, degrees.to_radians()))
}

/// The keyframes of a script or of an obstacle, ascending in time.
pub(super) fn keyframes(table: &Table) -> Result<Vec<Keyframe>, Error> {
    let example = "keyframes = [{ t = 0 }, { t = 1, translate = [0, 0.1, 0] }]";
    let places = table.required("keyframes", example)?;
    over_time(&places, &KEYFRAME, example, |table, time| {
        let translate =
            table.optional("translate", DVec3::ZERO, |place| place.vector("a translation from rest in m"))?;
        let (axis, angle) = table.optional("rotate", (DVec3::Y, 0.0), rotation)?;
        Ok(Keyframe { time, translate, axis, angle })
    })
}

/// Keyframes of a vector: `t`, and its key after that in `keys`.
pub(super) fn vector_keyframes(
    places: &Place,
    (keys, example): (&Keys, &str),
    what: &str,
    most: f64,
) -> Result<Vec<VectorKeyframe>, Error> {
    over_time(places, keys, example, |table, time| {
        let name = keys.valid[1];
        let value = table.required(name, &format!("{name} = [0, -1, 0], {what}"))?;
        Ok(VectorKeyframe { time, value: bounded(&value, what, most)? })
    })
}

/// The entries of a list of keyframes, at least one, ascending in time. `read` gets their tables and times (s).
pub(super) fn over_time<T>(
    places: &Place,
    keys: &Keys,
    example: &str,
    read: impl Fn(&Table, f64) -> Result<T, Error>,
) -> Result<Vec<T>, Error> {
    let mut last = None;
    let mut entries = Vec::new();
    for place in places.list()? {
        let table = place.table(keys)?;
        let time_place = table.required("t", "t = 0.5, in s")?;
        let time = time_place.number("the time of the keyframe in s")?;
        time_place.ensure(time >= 0.0, format!("is {time}, before the start"), "write a time of 0 s or later")?;
        if let Some(last) = last {
            time_place.ensure(
                time > last,
                format!("{time} s is not later than the keyframe before, {last} s"),
                "write the keyframes in ascending order of time",
            )?;
        }
        last = Some(time);
        entries.push(read(&table, time)?);
    }
    places.ensure(!entries.is_empty(), "has no entry", format!("write {example}"))?;
    Ok(entries)
}

/// Whether a box (m) and the domain have an interior point in common.
pub(crate) fn box_reaches([low, high]: [DVec3; 2], size: DVec3) -> bool {
    high.cmpgt(DVec3::ZERO).all() && low.cmplt(size).all()
}

impl Motion {
    /// Whether a body may reach the domain; `low` and `high` (m) are the corners of its bounding box before the motion.
    ///
    /// Tests the union box of each two successive poses: between keyframes the translation is linear. A rotating body may come from
    /// anywhere.
    pub(crate) fn may_reach(&self, [low, high]: [DVec3; 2], size: DVec3) -> bool {
        let frames = &self.keyframes;
        let next = frames.iter().skip(1).chain(frames.last());
        frames.iter().zip(next).any(|(frame, next)| {
            let [from, to] = [frame.translate, next.translate];
            let union = [low + from.min(to), high + from.max(to)];
            frame.angle != 0.0 || box_reaches(union, size)
        })
    }
}

impl Shape {
    /// Centre of rotation and scaling: the middle of a box, ball or cylinder. `None` for a mesh, whose centre follows from its file,
    /// and for half spaces and waves, which have no placement.
    pub fn centre(&self) -> Option<DVec3> {
        match self {
            Shape::Box { min, max } => Some(0.5 * (min + max)),
            Shape::Sphere { centre, .. } => Some(*centre),
            Shape::Cylinder { base, axis, height, .. } => Some(base + 0.5 * height * axis),
            Shape::HalfSpace { .. } | Shape::Wave { .. } | Shape::Solitary(_) | Shape::Mesh { .. } => None,
        }
    }

    /// Area of a box, ball or cylinder projected along a unit vector, m^2; 0 for other shapes.
    pub(crate) fn projected_area(&self, direction: DVec3) -> f64 {
        match *self {
            Shape::Box { min, max } => {
                let [x, y, z] = (max - min).to_array();
                direction.abs().dot(DVec3::new(y * z, z * x, x * y))
            }
            Shape::Sphere { radius, .. } => std::f64::consts::PI * radius * radius,
            Shape::Cylinder { axis, radius, height, .. } => {
                let along = direction.dot(axis).abs();
                let across = direction.cross(axis).length();
                radius * (std::f64::consts::PI * radius * along + 2.0 * height * across)
            }
            _ => 0.0,
        }
    }

    /// Low and high corner of the bounding box of a placed box, ball or cylinder, m; `None` for other shapes.
    pub(crate) fn bounds(&self, placement: &Placement) -> Option<[DVec3; 2]> {
        let half = match *self {
            Shape::Box { min, max } => {
                let columns = placement.rotate.to_cols_array();
                DMat3::from_cols_array(&columns.map(f64::abs)) * (0.5 * (max - min))
            }
            Shape::Sphere { radius, .. } => DVec3::splat(radius),
            Shape::Cylinder { axis, radius, height, .. } => {
                let axis = placement.rotate * axis;
                let rim = (DVec3::ONE - axis * axis).max(DVec3::ZERO);
                let rim = radius * DVec3::new(rim.x.sqrt(), rim.y.sqrt(), rim.z.sqrt());
                0.5 * height * axis.abs() + rim
            }
            _ => return None,
        };
        let centre = self.centre()? + placement.translate;
        let half = half * placement.scale;
        Some([centre - half, centre + half])
    }

    /// Whether a box, ball or cylinder lies in the box from the origin to `size`, to rounding.
    pub(crate) fn lies_in(&self, size: DVec3) -> bool {
        let slack = 1e-9 * size.max_element();
        self.bounds(&Placement::default())
            .is_some_and(|[low, high]| low.min_element() >= -slack && (high - size).max_element() <= slack)
    }

    /// Whether a part lies in the box from the origin to `size`, by bounding boxes; always true for meshes and solitary waves.
    pub(super) fn reaches(&self, placement: &Placement, size: DVec3) -> bool {
        match *self {
            Shape::Box { .. } | Shape::Cylinder { .. } => {
                let bounds = self.bounds(placement);
                bounds.is_some_and(|bounds| box_reaches(bounds, size))
            }
            Shape::Sphere { centre, radius } => {
                let centre = centre + placement.translate;
                let nearest = centre.clamp(DVec3::ZERO, size);
                nearest.distance(centre) < radius * placement.scale
            }
            Shape::HalfSpace { point, normal } => {
                let mut corners = corners(size).into_iter();
                corners.any(|corner| (corner - point).dot(normal) < 0.0)
            }
            Shape::Wave { level, amplitude, .. } => level + amplitude.abs() > 0.0,
            Shape::Solitary(_) | Shape::Mesh { .. } => true,
        }
    }

    /// Whether the shape contains the box from the origin to `size`. It is convex, so its corners decide; false for meshes.
    pub(super) fn contains_box(&self, placement: &Placement, size: DVec3) -> bool {
        let Some(centre) = self.centre() else {
            return false;
        };
        corners(size).into_iter().all(|corner| {
            // Relative to the centre, in the coordinates of the shape before its placement.
            let x = placement.rotate.transpose() * (corner - placement.translate - centre) / placement.scale;
            match self {
                Shape::Box { min, max } => x.abs().cmple(0.5 * (max - min)).all(),
                Shape::Sphere { radius, .. } => x.length() <= *radius,
                Shape::Cylinder { axis, radius, height, .. } => {
                    x.dot(*axis).abs() <= 0.5 * height && x.reject_from_normalized(*axis).length() <= *radius
                }
                Shape::HalfSpace { .. } | Shape::Wave { .. } | Shape::Solitary(_) | Shape::Mesh { .. } => false,
            }
        })
    }
}

/// The corners of the box from the origin to `size`.
pub(super) fn corners(size: DVec3) -> [DVec3; 8] {
    std::array::from_fn(|i| size * DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2 & 1) as f64))
}
