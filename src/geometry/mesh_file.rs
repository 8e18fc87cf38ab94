//! Closed surfaces from mesh files: OBJ, STL (text and binary), PLY (text and binary).

use std::borrow::Cow;
use std::cell::Cell;
use std::fs;
use std::io::{self, BufRead, Cursor, Read};
use std::path::Path;

use glam::DVec3;
use ply_rs_bw::parser::{ParseError, Parser};
use ply_rs_bw::ply::{DefaultElement, Property};

use super::{Fault, Surface};
use crate::error::Error;

/// What is wrong in a file, with the line where it is known, and what would be right.
pub(super) struct Problem {
    pub(super) line: Option<usize>,
    pub(super) problem: String,
    pub(super) cure: Cow<'static, str>,
}

impl Problem {
    pub(super) fn new(problem: impl Into<String>, cure: impl Into<Cow<'static, str>>) -> Problem {
        Problem {
            line: None,
            problem: problem.into(),
            cure: cure.into(),
        }
    }

    /// The error that names the file.
    pub(super) fn of(self, file: &Path) -> Error {
        let line = self.line.map(|line| format!(":{line}"));
        let what = format!("{}{}", file.display(), line.unwrap_or_default());
        Error::input(what, self.problem, self.cure)
    }
}

/// A line of a file, by its number from 1, as errors quote it: its first characters, those that control a terminal replaced.
fn quoted(bytes: &[u8], line: usize) -> String {
    const LONGEST: usize = 60;
    let text = bytes
        .split(|&byte| byte == b'\n')
        .nth(line.saturating_sub(1));
    let text = String::from_utf8_lossy(text.unwrap_or_default());
    let text = text.trim();
    let shown = text.chars().take(LONGEST);
    let shown: String = shown
        .map(|c| if c.is_control() { '\u{fffd}' } else { c })
        .collect();
    let more = if text.chars().nth(LONGEST).is_some() {
        " ..."
    } else {
        ""
    };
    format!("`{shown}{more}`")
}

impl From<Fault> for Problem {
    fn from(fault: Fault) -> Problem {
        Problem::new(fault.problem, fault.cure)
    }
}

/// All bytes of a mesh file.
pub(super) fn load(file: &Path) -> Result<Vec<u8>, Error> {
    fs::read(file).map_err(|problem| {
        let cure = "give the path of a readable mesh file, relative to the scene file";
        Problem::new(problem.to_string(), cure).of(file)
    })
}

/// The end of a file's name, in small letters.
pub(super) fn extension(file: &Path) -> String {
    let extension = file.extension().unwrap_or_default();
    extension.to_string_lossy().to_lowercase()
}

/// Reads a surface, merges vertices at equal positions (STL has no others) and refuses what does not bound a solid.
pub fn read(file: &Path) -> Result<Surface, Error> {
    parse(load(file)?, file)
}

/// The same from the contents of a file; its name says what they are, and stands in errors.
pub fn parse(bytes: Vec<u8>, file: &Path) -> Result<Surface, Error> {
    let extension = extension(file);
    let surface = match extension.as_str() {
        "obj" | "stl" | "ply" if bytes.is_empty() => Err(Problem::new(
            "the file is empty: no triangles",
            "export the mesh again, and see that the disk has room",
        )),
        "obj" => obj(&bytes),
        "stl" => stl(bytes),
        "ply" => ply(&bytes),
        _ => Err(Problem::new(
            "unknown kind of mesh file",
            "use .obj, .stl or .ply",
        )),
    }
    .map_err(|problem| problem.of(file))?
    .welded();
    match surface.fault() {
        Some(fault) => Err(Problem::from(fault).of(file)),
        None => Ok(surface),
    }
}

/// Bytes that are handed out line by line, counting the lines: tobj says what is wrong, but not where.
struct Lines<'a> {
    rest: &'a [u8],
    count: &'a Cell<usize>,
}

impl Read for Lines<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.fill_buf()?.read(buffer)?;
        self.consume(n);
        Ok(n)
    }
}

impl BufRead for Lines<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        let newline = self.rest.iter().position(|&byte| byte == b'\n');
        Ok(&self.rest[..newline.map_or(self.rest.len(), |at| at + 1)])
    }

    fn consume(&mut self, n: usize) {
        let (used, rest) = self.rest.split_at(n);
        let newlines = used.iter().filter(|&&byte| byte == b'\n').count();
        let ends_without = rest.is_empty() && used.last().is_some_and(|&byte| byte != b'\n');
        let lines = newlines + usize::from(ends_without);
        self.count.set(self.count.get() + lines);
        self.rest = rest;
    }
}

fn obj(bytes: &[u8]) -> Result<Surface, Problem> {
    let cure =
        "write v lines with three coordinates and f lines with the numbers of existing vertices";
    let lines = Cell::new(0);
    let mut reader = Lines {
        rest: bytes,
        count: &lines,
    };
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..Default::default()
    };
    // Materials do not matter here.
    let no_materials = |_: &Path| Ok(Default::default());
    let (models, _) =
        tobj::load_obj_buf(&mut reader, &options, no_materials).map_err(|problem| {
            let line = match problem {
                tobj::LoadError::PositionParseError
                | tobj::LoadError::NormalParseError
                | tobj::LoadError::TexcoordParseError
                | tobj::LoadError::FaceParseError
                | tobj::LoadError::ColorParseError => Some(lines.get()),
                // Faces are looked up at the end of their object.
                tobj::LoadError::FaceVertexOutOfBounds => line_of_stray_face(bytes),
                _ => None,
            };
            let quoted = line.map_or_else(String::new, |line| quoted(bytes, line) + ": ");
            Problem {
                line,
                problem: format!("{quoted}{problem}"),
                cure: cure.into(),
            }
        })?;
    let mut surface = Surface::default();
    for mesh in models.iter().map(|model| &model.mesh) {
        let first = surface.vertices.len() as u32;
        let (positions, _) = mesh.positions.as_chunks::<3>();
        let (triangles, _) = mesh.indices.as_chunks::<3>();
        surface
            .vertices
            .extend(positions.iter().map(|&x| DVec3::from_array(x)));
        surface.triangles.extend(
            triangles
                .iter()
                .map(|triangle| triangle.map(|vertex| first + vertex)),
        );
    }
    Ok(surface)
}

/// The line of the first face of an OBJ file with a vertex that does not exist.
fn line_of_stray_face(bytes: &[u8]) -> Option<usize> {
    let text = String::from_utf8_lossy(bytes);
    let n_vertices = text.lines().filter(|line| line.starts_with("v ")).count() as u64;
    let strays = |corner: &str| {
        let number = corner
            .split('/')
            .next()
            .and_then(|number| number.parse::<i64>().ok());
        number.is_some_and(|number| !(1..=n_vertices).contains(&number.unsigned_abs()))
    };
    let stray = text.lines().position(|line| {
        let corners = line.strip_prefix("f ").map(str::split_whitespace);
        corners.is_some_and(|mut corners| corners.any(strays))
    });
    stray.map(|line| line + 1)
}

fn stl(mut bytes: Vec<u8>) -> Result<Surface, Problem> {
    let cure = "export the surface again, as binary or text STL";
    // Some programs begin the free 80-byte header of a binary file with the word that begins a text file. Only the length
    // tells them apart.
    if let Some(&count) = bytes.get(80..).and_then(|rest| rest.first_chunk::<4>())
        && bytes.len() == 84 + 50 * u32::from_le_bytes(count) as usize
    {
        bytes[..80].fill(0);
    }
    let mut cursor = Cursor::new(bytes);
    let triangles = stl_io::create_stl_reader(&mut cursor)
        .map_err(|problem| Problem::new(format!("not an STL file: {problem}"), cure))?;
    let mut surface = Surface::default();
    for (number, triangle) in triangles.enumerate() {
        let triangle = triangle.map_err(|problem| {
            let number = number + 1;
            let told = match problem.kind() {
                io::ErrorKind::UnexpectedEof => {
                    format!("the file ends in or before facet {number}")
                }
                _ => format!("facet {number}: {problem}"),
            };
            Problem::new(told, cure)
        })?;
        let first = surface.vertices.len() as u32;
        for vertex in triangle.vertices {
            surface
                .vertices
                .push(DVec3::from_array(vertex.0.map(f64::from)));
        }
        surface.triangles.push([first, first + 1, first + 2]);
    }
    Ok(surface)
}

const PLY_CURE: &str =
    "give elements `vertex` with x, y, z and `face` with the list vertex_indices";

/// Why a PLY file cannot be read. All that the library tells of a line is how its grammar came to an end.
fn no_ply(bytes: &[u8], problem: &ParseError) -> Problem {
    let told = problem.to_string();
    let told = told.lines().next().unwrap_or_default();
    let number = problem.line().map(|line| format!("Line {line}: "));
    let told = number
        .and_then(|number| told.strip_prefix(&number))
        .unwrap_or(told);
    if problem.kind() == io::ErrorKind::UnexpectedEof {
        return Problem::new(format!("the file ends too early: {told}"), PLY_CURE);
    }
    let mut lines = bytes.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii);
    let before_end = lines.clone().position(|line| line == b"end_header");
    let n_header = before_end.map_or(usize::MAX, |before| before + 1);
    let is_binary = lines.any(|line| line.starts_with(b"format binary"));
    let (line, problem) = match problem.line() {
        Some(line) if line <= n_header => (line, "does not belong there in the header"),
        Some(line) if !is_binary => (line, "is not what the header asks for"),
        _ => return Problem::new(told, PLY_CURE),
    };
    Problem {
        line: Some(line),
        ..Problem::new(format!("{} {problem}", quoted(bytes, line)), PLY_CURE)
    }
}

fn ply(bytes: &[u8]) -> Result<Surface, Problem> {
    let first = bytes.split(|&byte| byte == b'\n').next();
    if first.map(<[u8]>::trim_ascii) != Some(b"ply") {
        let problem = "not a PLY file: its first line is not `ply`";
        return Err(Problem::new(problem, PLY_CURE));
    }
    let file = Parser::<DefaultElement>::new()
        .read_ply(&mut Cursor::new(bytes))
        .map_err(|problem| no_ply(bytes, &problem))?;
    let elements = |name: &str| {
        file.payload
            .get(name)
            .ok_or_else(|| Problem::new(format!("no element `{name}`"), PLY_CURE))
    };
    let mut surface = Surface::default();
    for (number, vertex) in elements("vertex")?.iter().enumerate() {
        let coordinate = |name: &str| match vertex.get(name) {
            Some(&Property::Float(x)) => Ok(f64::from(x)),
            Some(&Property::Double(x)) => Ok(x),
            _ => Err(Problem::new(
                format!("vertex {}: no float or double `{name}`", number + 1),
                PLY_CURE,
            )),
        };
        surface.vertices.push(DVec3::new(
            coordinate("x")?,
            coordinate("y")?,
            coordinate("z")?,
        ));
    }
    let n_vertices = surface.vertices.len();
    for (number, face) in elements("face")?.iter().enumerate() {
        let problem =
            |problem: String| Problem::new(format!("face {}: {problem}", number + 1), PLY_CURE);
        let corners = face
            .get("vertex_indices")
            .or_else(|| face.get("vertex_index"))
            .and_then(Property::to_u32_list)
            .ok_or_else(|| problem("no list `vertex_indices` of vertex numbers".to_owned()))?;
        if let Some(corner) = corners
            .iter()
            .find(|&&corner| corner as usize >= n_vertices)
        {
            return Err(problem(format!(
                "vertex {corner}, but there are {n_vertices}, counted from 0"
            )));
        }
        let &[first, ref rest @ ..] = corners.as_slice() else {
            return Err(problem("no vertices".to_owned()));
        };
        if rest.len() < 2 {
            return Err(problem("fewer than 3 vertices".to_owned()));
        }
        surface
            .triangles
            .extend(rest.windows(2).map(|pair| [first, pair[0], pair[1]]));
    }
    Ok(surface)
}
