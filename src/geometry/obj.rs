//! Surfaces from OBJ files: vertices and polygons. Texture coordinates, normals, lines, points and curves are ignored.

use std::iter::Peekable;

use glam::DVec3;

use super::Surface;
use super::mesh_file::{Problem, lines, number, without_mark, words};
use super::polygon::{Defect, Polygons};

const CURE: &str =
    "write v lines with three coordinates and f lines with the numbers of existing vertices";

/// Kinds of statements.
#[derive(Clone, Copy, PartialEq)]
enum Statement {
    Vertex,
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
        "f" | "fo" => Statement::Face,
        "g" | "o" | "usemtl" | "mtllib" | "usemap" | "maplib" | "shadow_obj" | "trace_obj" => {
            Statement::Name
        }
        "vt" | "vn" | "vp" | "vc" | "l" | "p" | "s" | "mg" | "lod" | "bevel" | "c_interp"
        | "d_interp" | "ctech" | "stech" | "curv" | "curv2" | "cstype" | "deg" | "bmat"
        | "step" | "parm" | "trim" | "hole" | "scrv" | "sp" | "end" | "con" => Statement::Ignored,
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
        if is_name
            && words(next)
                .next()
                .is_none_or(|word| statement(word).is_some())
        {
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
pub(super) fn read(bytes: &[u8]) -> Result<Surface, Problem> {
    let mut surface = Surface::default();
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
        let mut rest = words(&joined)
            .skip(1)
            .take_while(|word| !word.starts_with(b"#"));
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
                let mut x = DVec3::ZERO;
                for axis in 0..3 {
                    let word = rest
                        .next()
                        .ok_or_else(|| problem("a position of fewer than three coordinates"))?;
                    x[axis] = number(word).map_err(|word| problem(&format!("position: {word}")))?;
                }
                // Weights and colours may follow.
                for word in rest {
                    number::<f64>(word).map_err(|word| problem(&word))?;
                }
                surface.vertices.push(x);
            }
            Statement::Face => {
                let n = surface.vertices.len() as i64;
                for corner in rest {
                    let vertex = corner.split(|&byte| byte == b'/').next();
                    let vertex: i64 =
                        number(vertex.unwrap_or_default()).map_err(|word| problem(&word))?;
                    let known = if vertex < 0 {
                        vertex.checked_add(n)
                    } else {
                        Some(vertex - 1)
                    };
                    let known = known.and_then(|number| u32::try_from(number).ok());
                    polygons.push_corner(known.ok_or_else(|| problem(&out_of_bounds(vertex, n)))?);
                }
                polygons.end(here);
            }
        }
    }
    let n = surface.vertices.len() as i64;
    surface.triangles = polygons.triangles(&surface.vertices, |here, defect| match defect {
        Defect::NoVertex(vertex) => {
            Problem::at_line(here, out_of_bounds(i64::from(vertex) + 1, n), CURE)
        }
        Defect::Shape(reason) => Problem::at_line(
            here,
            format!("the polygon {reason}"),
            "repair the polygon in a mesh tool, or cut it into triangles",
        ),
    })?;
    Ok(surface)
}

fn out_of_bounds(vertex: i64, n: i64) -> String {
    format!("vertex {vertex} is out of bounds: {n} vertices, counted from 1")
}
