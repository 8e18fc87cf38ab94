//! Surfaces from STL files, text and binary: facets of all solids. Normals are ignored, since the order of corners defines
//! them.

use glam::{DVec3, Vec3};

use super::Surface;
use super::mesh_file::{Problem, lines, number, quoted, without_mark, words};
use super::polygon::triangulate;

const CURE: &str = "export the surface again, as binary or text STL";

/// Bytes before the facets of a binary solid.
const HEADER: usize = 84;
const FACET: usize = 50;

/// Reads the facets in the order of the file.
pub(super) fn read(bytes: &[u8]) -> Result<Surface, Problem> {
    if header(bytes).is_some_and(|(n, facets)| facets.len() as u64 == n as u64 * FACET as u64) {
        return binary_solids(bytes);
    }
    let text = without_mark(bytes)?;
    let begins_as_text = words(text.trim_ascii_start()).next().is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    // Free headers of binary files may begin with `solid`, but a text contains no zeros.
    match bytes.contains(&0) {
        true => binary_solids(bytes),
        false if begins_as_text => text_solids(text),
        false => Err(Problem::new("not an STL file: neither binary nor a text that begins with `solid`", CURE)),
    }
}

/// Number of facets of a binary solid, and its bytes from the facets on.
fn header(bytes: &[u8]) -> Option<(usize, &[u8])> {
    let count = bytes.get(HEADER - 4..)?.first_chunk::<4>()?;
    Some((u32::from_le_bytes(*count) as usize, &bytes[HEADER..]))
}

/// One or several solids.
fn binary_solids(bytes: &[u8]) -> Result<Surface, Problem> {
    let mut surface = Surface::default();
    let mut rest = bytes;
    while !rest.trim_ascii().is_empty() {
        let begin = bytes.len() - rest.len();
        let Some((n, facets)) = header(rest) else {
            let problem = match begin {
                0 => "not an STL file: fewer than the 84 bytes before the facets".to_owned(),
                _ => format!("{} bytes are left over behind the last facet", rest.len()),
            };
            return Err(Problem::new(problem, CURE));
        };
        // In u64 the bytes of 2^32 facets do not overflow.
        if (facets.len() as u64) < n as u64 * FACET as u64 {
            let problem = match begin {
                0 => format!(
                    "not an STL file, or cut off: the file ends in or before facet {} of {n}",
                    facets.len() / FACET + 1
                ),
                _ => format!("{} bytes are left over behind the last facet", rest.len()),
            };
            return Err(Problem::new(problem, CURE));
        }
        let (facets, behind) = facets.split_at(n * FACET);
        rest = behind;
        for facet in facets.chunks_exact(FACET) {
            let (numbers, _) = facet[12..48].as_chunks::<4>();
            let (corners, _) = numbers.as_chunks::<3>();
            let first = surface.vertices.len() as u32;
            let vertices = corners.iter().map(|corner| Vec3::from_array(corner.map(f32::from_le_bytes)).as_dvec3());
            surface.vertices.extend(vertices);
            surface.triangles.push([first, first + 1, first + 2]);
        }
    }
    Ok(surface)
}

/// Grammar state of a text: the expected word.
#[derive(Clone, Copy, PartialEq)]
enum Next {
    Solid,
    /// `facet` or `endsolid`
    Facet,
    /// `outer`, behind a normal of any words.
    Outer,
    Loop,
    /// `vertex` or `endloop`
    Vertex,
    Coordinate,
    EndFacet,
}

impl Next {
    fn words(self) -> &'static str {
        match self {
            Next::Solid => "`solid`",
            Next::Facet => "`facet` or `endsolid`",
            Next::Outer => "`outer loop`",
            Next::Loop => "`loop`",
            Next::Vertex => "`vertex` or `endloop`",
            Next::Coordinate => "a coordinate",
            Next::EndFacet => "`endfacet`",
        }
    }
}

/// One or several solids; words in any case, names in any encoding.
fn text_solids(bytes: &[u8]) -> Result<Surface, Problem> {
    let mut surface = Surface::default();
    let mut next = Next::Solid;
    let mut facet = 0;
    // Coordinates of the current facet.
    let mut coordinates: Vec<f64> = Vec::new();
    for here in lines(bytes) {
        let mut rest = words(here.1);
        while let Some(word) = rest.next() {
            let problem = |problem: &str| Problem::at_line(here, format!("facet {facet}: {problem}"), CURE);
            let before = next;
            next = match (before, word.to_ascii_lowercase().as_slice()) {
                (Next::Solid, b"solid") => skip_name(&mut rest, Next::Facet),
                (Next::Facet, b"endsolid") => skip_name(&mut rest, Next::Solid),
                (Next::Facet, b"facet") => Next::Outer,
                (Next::Outer, b"outer") => Next::Loop,
                (Next::Outer, b"facet" | b"vertex" | b"endloop" | b"endfacet" | b"endsolid") => {
                    return Err(problem("no `outer loop`"));
                }
                (Next::Outer, _) => Next::Outer,
                (Next::Loop, b"loop") => {
                    coordinates.clear();
                    Next::Vertex
                }
                (Next::Vertex, b"vertex") => Next::Coordinate,
                (Next::Vertex, b"endloop") => {
                    polygon(&coordinates, &mut surface).map_err(|why| problem(&format!("it {why}")))?;
                    Next::EndFacet
                }
                (Next::Coordinate, _) => {
                    // Single precision, as in binary files.
                    let x: f32 = number(word).map_err(|word| problem(&word))?;
                    coordinates.push(f64::from(x));
                    if coordinates.len().is_multiple_of(3) { Next::Vertex } else { Next::Coordinate }
                }
                (Next::EndFacet, b"endfacet") => Next::Facet,
                (expected, _) => {
                    let problem = format!("facet {facet}: {} where {} belongs", quoted(word), expected.words());
                    return Err(Problem::at_line(here, problem, CURE));
                }
            };
            facet += usize::from(next == Next::Outer && before != Next::Outer);
        }
    }
    if next != Next::Solid {
        let place = match next {
            Next::Facet => "behind",
            _ => "in",
        };
        let problem = format!("the file ends {place} facet {facet}, where {} belongs", next.words());
        return Err(Problem::new(problem, CURE));
    }
    Ok(surface)
}

/// Skips a name, which ends at the end of the line or at a facet.
fn skip_name<'a>(rest: &mut (impl Iterator<Item = &'a [u8]> + Clone), behind: Next) -> Next {
    while let Some(word) = rest.next() {
        let begins = rest.clone().next().is_some_and(|word| word.eq_ignore_ascii_case(b"normal"));
        if begins && word.eq_ignore_ascii_case(b"facet") {
            return Next::Outer;
        }
    }
    behind
}

/// Adds a facet, which may have more than three corners.
fn polygon(coordinates: &[f64], surface: &mut Surface) -> Result<(), &'static str> {
    let (corners, _) = coordinates.as_chunks::<3>();
    let first = surface.vertices.len() as u32;
    let numbers: Vec<u32> = (first..).take(corners.len()).collect();
    surface.vertices.extend(corners.iter().map(|&x| DVec3::from_array(x)));
    if let [a, b, c] = *numbers {
        surface.triangles.push([a, b, c]);
        return Ok(());
    }
    surface.triangles.extend(triangulate(&surface.vertices, &numbers)?);
    Ok(())
}
