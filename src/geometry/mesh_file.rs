//! Closed surfaces from mesh files; lines, words and numbers of text files.

use std::borrow::Cow;
use std::fs;
use std::path::Path;
use std::str::FromStr;

use super::render_mesh::RenderMesh;
use super::{Fault, Surface, gltf, obj, ply, stl};
use crate::error::Error;

/// An error in a file, with its line if known.
pub(super) struct Problem {
    pub(super) line: Option<usize>,
    pub(super) problem: String,
    pub(super) cure: Cow<'static, str>,
}

impl Problem {
    /// An error in a line, which is quoted.
    pub(super) fn at_line(
        (line, text): (usize, &[u8]),
        problem: impl AsRef<str>,
        cure: impl Into<Cow<'static, str>>,
    ) -> Problem {
        Problem { line: Some(line), ..Problem::new(format!("{}: {}", quoted(text), problem.as_ref()), cure) }
    }

    pub(super) fn new(problem: impl Into<String>, cure: impl Into<Cow<'static, str>>) -> Problem {
        Problem { line: None, problem: problem.into(), cure: cure.into() }
    }

    pub(super) fn in_file(self, file: &Path) -> Error {
        let line = self.line.map(|line| format!(":{line}"));
        let what = format!("{}{}", file.display(), line.unwrap_or_default());
        Error::input(what, self.problem, self.cure)
    }
}

/// Beginning of a text for errors, with control characters replaced.
pub(super) fn quoted(text: &[u8]) -> String {
    const LONGEST: usize = 60;
    let text = String::from_utf8_lossy(text);
    let text = text.trim();
    let shown = text.chars().take(LONGEST);
    let shown: String = shown.map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    let more = if text.chars().nth(LONGEST).is_some() { " ..." } else { "" };
    format!("`{shown}{more}`")
}

/// The text without a byte order mark. It need not be UTF-8: names and comments may have any encoding that extends ASCII.
pub(super) fn without_mark(bytes: &[u8]) -> Result<&[u8], Problem> {
    if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        return Err(Problem::new("a text in UTF-16", "save the file as UTF-8 or ASCII in an editor"));
    }
    Ok(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes))
}

/// The first line, which ends in LF, CR LF or CR, and the bytes behind it.
pub(super) fn split_line(bytes: &[u8]) -> (&[u8], &[u8]) {
    let end = bytes.iter().position(|byte| b"\r\n".contains(byte));
    let (line, behind) = bytes.split_at(end.unwrap_or(bytes.len()));
    let newline = if behind.starts_with(b"\r\n") { 2 } else { 1 };
    (line, behind.get(newline..).unwrap_or_default())
}

/// Lines with their numbers from 1.
pub(super) fn lines(mut bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let lines = std::iter::from_fn(move || {
        let (line, behind) = (!bytes.is_empty()).then(|| split_line(bytes))?;
        bytes = behind;
        Some(line)
    });
    (1..).zip(lines)
}

pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> + Clone {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// Parses a number; the error describes the word.
pub(super) fn number<T: FromStr>(word: &[u8]) -> Result<T, String> {
    let text = str::from_utf8(word).ok();
    text.and_then(|text| text.parse().ok()).ok_or_else(|| {
        let comma = if word.contains(&b',') { " (decimals are written with a point)" } else { "" };
        format!("{} is not a number{comma}", quoted(word))
    })
}

/// The little-endian bytes of a number.
pub(super) fn little_endian<const N: usize>(mut bytes: [u8; N], big_endian: bool) -> [u8; N] {
    if big_endian {
        bytes.reverse();
    }
    bytes
}

impl From<Fault> for Problem {
    fn from(fault: Fault) -> Problem {
        Problem::new(fault.problem, fault.cure)
    }
}

pub(super) fn load(file: &Path) -> Result<Vec<u8>, Error> {
    fs::read(file).map_err(|problem| {
        let cure = "give the path of a readable mesh file: in a scene relative to its folder, in a command to the working directory";
        Problem::new(problem.to_string(), cure).in_file(file)
    })
}

pub(super) fn extension(file: &Path) -> String {
    let extension = file.extension().unwrap_or_default();
    extension.to_string_lossy().to_lowercase()
}

/// Reads a surface and merges vertices at equal positions, which STL repeats. A surface that bounds no solid is an error.
pub fn read(file: &Path) -> Result<Surface, Error> {
    parse(load(file)?, file)
}

/// Parses the contents of a file; the extension of its name is the format.
pub fn parse(bytes: Vec<u8>, file: &Path) -> Result<Surface, Error> {
    let surface = parse_render_mesh(&bytes, file)?.into_surface().welded();
    match surface.fault() {
        Some(fault) => Err(Problem::from(fault).in_file(file)),
        None => Ok(surface),
    }
}

/// Parses a mesh, which may bound no solid.
pub(super) fn parse_render_mesh(bytes: &[u8], file: &Path) -> Result<RenderMesh, Error> {
    let extension = extension(file);
    match extension.as_str() {
        "obj" | "stl" | "ply" | "glb" | "gltf" if bytes.is_empty() => Err(Problem::new(
            "the file is empty: no triangles",
            "export the mesh again, and see that the disk has room",
        )),
        "obj" => obj::read(bytes),
        "stl" => stl::read(bytes).map(RenderMesh::from),
        "ply" => ply::read(bytes),
        "glb" | "gltf" => gltf::read(bytes),
        _ => Err(Problem::new("unknown kind of mesh file", "use .obj, .stl, .ply, .glb or .gltf")),
    }
    .map_err(|problem| problem.in_file(file))
}
