//! Meshes from OBJ files: polygons with texture coordinates and normals. Lines, points and curves are ignored.
//!
//! Corners with equal numbers of position, texture coordinates and normal are one vertex.

use std::collections::HashMap;
use std::iter::Peekable;

use glam::DVec3;

use super::mesh_file::{Problem, lines, number, without_mark, words};
use super::polygon::{Defect, Polygons};
use super::render_mesh::RenderMesh;

const CURE: &str = "write v lines with three coordinates and f lines with the numbers of existing vertices";

/// Kinds of statements.
#[derive(Clone, Copy, PartialEq)]
enum Statement {
    Vertex,
    Texture,
    Normal,
    Face,
    /// A comment, or names of groups, materials and files.
    Name,
    /// Numbers irrelevant for a surface.
    Ignored,
    /// Geometry other than polygons.
    Unsupported,
}

/// The statement of a keyword, in any case.
fn statement(keyword: &[u8]) -> Option<Statement> {
    if keyword.starts_with(b"#") {
        return Some(Statement::Name);
    }
    Some(match str::from_utf8(&keyword.to_ascii_lowercase()).ok()? {
        "v" => Statement::Vertex,
        "vt" => Statement::Texture,
        "vn" => Statement::Normal,
        "f" | "fo" => Statement::Face,
        "g" | "o" | "usemtl" | "mtllib" | "usemap" | "maplib" | "shadow_obj" | "trace_obj" => Statement::Name,
        "vp" | "vc" | "l" | "p" | "s" | "mg" | "lod" | "bevel" | "c_interp" | "d_interp" | "ctech" | "stech"
        | "curv" | "curv2" | "cstype" | "deg" | "bmat" | "step" | "parm" | "trim" | "hole" | "scrv" | "sp" | "end"
        | "con" => Statement::Ignored,
        "surf" | "bsp" | "bzp" | "cdp" | "res" | "call" | "csh" => Statement::Unsupported,
        _ => return None,
    })
}

type Line<'a> = (usize, &'a [u8]);

/// The statement of a line and the lines that continue it.
fn join_lines<'a>(
    here: Line,
    kind: Statement,
    lines: &mut Peekable<impl Iterator<Item = Line<'a>>>,
) -> Result<Vec<u8>, Problem> {
    let (_, text) = here;
    let mut joined = text.trim_ascii_end().to_vec();
    // A backslash joins lines, but at the end of a comment or name it may belong to a Windows path.
    let is_name = kind == Statement::Name || text.contains(&b'#');
    while joined.ends_with(b"\\") {
        joined.pop();
        let Some(&(_, next)) = lines.peek() else {
            break;
        };
        if is_name && words(next).next().is_none_or(|word| statement(word).is_some()) {
            break;
        }
        let next = next.trim_ascii_end();
        let is_digit = |byte: Option<&u8>| byte.is_some_and(|byte| !byte.is_ascii_whitespace());
        if !is_name && next != b"\\" && is_digit(joined.last()) && is_digit(next.first()) {
            return Err(Problem::at_line(
                here,
                "the backslash that joins two lines may cut a number in two",
                "write a space before the backslash",
            ));
        }
        joined.extend(next);
        lines.next();
    }
    Ok(joined)
}

/// Reads the polygons as triangles, in the order of the file.
pub(super) fn read(bytes: &[u8]) -> Result<RenderMesh, Problem> {
    let (mut positions, mut texture, mut normals) = (Vec::new(), Vec::new(), Vec::new());
    let mut corners = Corners::default();
    let mut polygons: Polygons<Line> = Polygons::new();
    let mut lines = lines(without_mark(bytes)?).peekable();
    while let Some(here) = lines.next() {
        let problem = |problem: &str| Problem::at_line(here, problem, CURE);
        let Some(keyword) = words(here.1).next() else {
            continue;
        };
        let kind = statement(keyword).ok_or_else(|| {
            let problem = "no statement of an OBJ file";
            Problem::at_line(here, problem, "remove the line, or begin it with #")
        })?;
        let joined = join_lines(here, kind, &mut lines)?;
        let mut rest = words(&joined).skip(1).take_while(|word| !word.starts_with(b"#"));
        match kind {
            Statement::Name | Statement::Ignored => {}
            Statement::Unsupported => {
                return Err(Problem::at_line(
                    here,
                    "free-form surfaces and other files are not supported",
                    "export the surface as a mesh of polygons",
                ));
            }
            Statement::Vertex => {
                positions.push(vector(&mut rest, "a position of fewer than three coordinates", "position: ", here)?);
                // Weights and colours may follow.
                for word in rest {
                    number::<f64>(word).map_err(|word| problem(&word))?;
                }
            }
            Statement::Normal => {
                normals.push(vector(&mut rest, "a normal of fewer than three coordinates", "normal: ", here)?);
            }
            Statement::Texture => {
                // One coordinate is enough for a line of colours.
                let mut uv = [0.0_f32; 2];
                for (value, word) in uv.iter_mut().zip(rest) {
                    *value = number(word).map_err(|word| problem(&format!("texture: {word}")))?;
                }
                texture.push(uv);
            }
            Statement::Face => {
                let counts = [positions.len(), texture.len(), normals.len()];
                for corner in rest {
                    let mut parts = corner.split(|&byte| byte == b'/');
                    let mut numbers = [None; 3];
                    for (part, n) in [0, 1, 2].into_iter().zip(counts) {
                        let word = parts.next().unwrap_or_default();
                        if part > 0 && word.is_empty() {
                            continue;
                        }
                        let vertex: i64 = number(word).map_err(|word| problem(&word))?;
                        let known = if vertex < 0 { vertex.checked_add(n as i64) } else { Some(vertex - 1) };
                        let known = known.and_then(|number| u32::try_from(number).ok());
                        let known = known.ok_or_else(|| problem(&out_of_bounds(PARTS[part], vertex, n)))?;
                        numbers[part] = Some(known);
                    }
                    polygons.push_corner(corners.number(numbers, here));
                }
                polygons.end(here);
            }
        }
    }
    let mut mesh = RenderMesh::default();
    for (numbers, here) in &corners.all {
        let counts = [positions.len(), texture.len(), normals.len()];
        for part in 0..3 {
            if let Some(number) = numbers[part].filter(|&number| number as usize >= counts[part]) {
                let problem = out_of_bounds(PARTS[part], i64::from(number) + 1, counts[part]);
                return Err(Problem::at_line(*here, problem, CURE));
            }
        }
        let [position, uv, normal] = numbers.map(|number| number.map(|number| number as usize));
        mesh.vertices.push(positions[position.unwrap_or_default()]);
        mesh.texture.push(uv.map_or([0.0; 2], |uv| texture[uv]));
        mesh.normals.push(normal.map_or(DVec3::ZERO, |normal| normals[normal]));
    }
    let lacks = |part: usize| corners.all.iter().all(|(numbers, _)| numbers[part].is_none());
    if lacks(1) {
        mesh.texture.clear();
    }
    if lacks(2) || mesh.normals.contains(&DVec3::ZERO) {
        mesh.normals.clear();
    }
    mesh.triangles = polygons.triangles(&mesh.vertices, |here, defect| match defect {
        Defect::NoVertex(_) => Problem::at_line(here, "a corner without a vertex", CURE),
        Defect::Shape(reason) => Problem::at_line(
            here,
            format!("the polygon {reason}"),
            "repair the polygon in a mesh tool, or cut it into triangles",
        ),
    })?;
    Ok(mesh)
}

/// Names of the three numbers of a corner.
const PARTS: [&str; 3] = ["vertex", "texture vertex", "normal"];

/// Numbers of position, texture coordinates and normal, from 0.
type Numbers = [Option<u32>; 3];

/// The distinct corners, in the order of their first use.
#[derive(Default)]
struct Corners<'a> {
    all: Vec<(Numbers, Line<'a>)>,
    known: HashMap<Numbers, u32>,
}

impl<'a> Corners<'a> {
    fn number(&mut self, numbers: Numbers, here: Line<'a>) -> u32 {
        *self.known.entry(numbers).or_insert_with(|| {
            self.all.push((numbers, here));
            self.all.len() as u32 - 1
        })
    }
}

/// The next three numbers of a line.
fn vector<'a>(words: &mut impl Iterator<Item = &'a [u8]>, few: &str, what: &str, here: Line) -> Result<DVec3, Problem> {
    let mut x = DVec3::ZERO;
    for axis in 0..3 {
        let word = words.next().ok_or_else(|| Problem::at_line(here, few, CURE))?;
        x[axis] = number(word).map_err(|word| Problem::at_line(here, format!("{what}{word}"), CURE))?;
    }
    Ok(x)
}

fn out_of_bounds(part: &str, number: i64, n: usize) -> String {
    let many = match part {
        "vertex" => "vertices",
        "normal" => "normals",
        _ => "texture vertices",
    };
    format!("{part} {number} is out of bounds: {n} {many}, counted from 1")
}
