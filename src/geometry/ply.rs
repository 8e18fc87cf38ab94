//! Surfaces from PLY files, text and binary: vertices, polygons and triangle strips. Other elements and properties are skipped.

use glam::DVec3;

use super::mesh_file::{Problem, little_endian, number, quoted, split_line, without_mark, words};
use super::polygon::{Defect, Polygons};
use super::render_mesh::RenderMesh;

const CURE: &str = "give elements `vertex` with x, y, z and `face` with the list vertex_indices";

/// Names of texture coordinates: of Blender, of VCGlib and of others.
const TEXTURE: [[&str; 2]; 3] = [["s", "t"], ["texture_u", "texture_v"], ["u", "v"]];

/// Scalar types.
#[derive(Clone, Copy)]
enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Type {
    fn named(name: &[u8]) -> Option<Type> {
        Some(match name {
            b"char" | b"int8" => Type::I8,
            b"uchar" | b"uint8" => Type::U8,
            b"short" | b"int16" => Type::I16,
            b"ushort" | b"uint16" => Type::U16,
            b"int" | b"int32" => Type::I32,
            b"uint" | b"uint32" => Type::U32,
            b"float" | b"float32" => Type::F32,
            b"double" | b"float64" => Type::F64,
            _ => return None,
        })
    }

    fn is_whole(self) -> bool {
        !matches!(self, Type::F32 | Type::F64)
    }
}

struct Property {
    name: Vec<u8>,
    /// Type of a list's count.
    count: Option<Type>,
    kind: Type,
}

struct Element {
    name: Vec<u8>,
    n: u64,
    properties: Vec<Property>,
}

impl Element {
    fn index(&self, name: &str) -> Option<usize> {
        let mut names = self.properties.iter().map(|property| &property.name);
        names.position(|known| known == name.as_bytes())
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Format {
    Text,
    LittleEndian,
    BigEndian,
}

/// Values of one element. An f64 represents every PLY number.
#[derive(Default)]
struct Row {
    values: Vec<f64>,
    /// End of each property's values.
    ends: Vec<usize>,
}

impl Row {
    fn values(&self, property: usize) -> &[f64] {
        let start = property.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.values[start..self.ends[property]]
    }
}

/// Reads faces and strips in the order of the file.
pub(super) fn read(bytes: &[u8]) -> Result<RenderMesh, Problem> {
    let (format, elements, mut data) = header(without_mark(bytes)?)?;
    let mut surface = RenderMesh::default();
    let mut polygons: Polygons<(&str, u64)> = Polygons::new();
    let mut row = Row::default();
    for element in &elements {
        let name = String::from_utf8_lossy(&element.name);
        let is_vertex = element.name == b"vertex";
        let list = ["vertex_indices", "vertex_index"].iter().find_map(|name| element.index(name));
        let coordinates = ["x", "y", "z"].map(|name| element.index(name).ok_or(name));
        let n = match element.properties.is_empty() {
            true => 0,
            false => element.n,
        };
        for number in 1..=n {
            let problem = |problem: String| Problem::new(format!("{name} {number}: {problem}"), CURE);
            data.read(format, element, number, &mut row)?;
            if is_vertex {
                let mut x = DVec3::ZERO;
                for (axis, index) in coordinates.iter().enumerate() {
                    let index = index.map_err(|name| problem(format!("no number `{name}`")))?;
                    let &[value] = row.values(index) else {
                        return Err(problem("a list where a coordinate belongs".to_owned()));
                    };
                    x[axis] = value;
                }
                surface.vertices.push(x);
                for names in TEXTURE {
                    if let [Some(u), Some(v)] = names.map(|name| element.index(name))
                        && let (&[u], &[v]) = (row.values(u), row.values(v))
                    {
                        surface.texture.push([u as f32, v as f32]);
                        break;
                    }
                }
                continue;
            }
            let is_strip = element.name == b"tristrips";
            let Some(list) = list.filter(|_| is_strip || element.name == b"face") else {
                continue;
            };
            let numbers = row.values(list);
            let mut polygon = |vertices: &[f64]| {
                for &vertex in vertices {
                    // Above any vertex count, so that the conversion is exact.
                    let known = vertex >= 0.0 && vertex < f64::from(u32::MAX) && vertex.fract() == 0.0;
                    if !known {
                        return Err(problem(format!("{vertex} is no number of a vertex")));
                    }
                    polygons.push_corner(vertex as u32);
                }
                polygons.end((if is_strip { "strip" } else { "face" }, number));
                Ok(())
            };
            if is_strip {
                // A strip ends with -1; every other triangle has the opposite orientation.
                for strip in numbers.split(|&vertex| vertex == -1.0) {
                    for (number, triangle) in strip.windows(3).enumerate() {
                        let (a, b, c) = (triangle[0], triangle[1], triangle[2]);
                        if a != b && b != c && c != a {
                            polygon(&if number % 2 == 0 { [a, b, c] } else { [b, a, c] })?;
                        }
                    }
                }
            } else {
                polygon(numbers)?;
            }
        }
    }
    data.end()?;
    let n = surface.vertices.len();
    surface.triangles = polygons.triangles(&surface.vertices, |(name, number), defect| {
        let problem = match defect {
            Defect::NoVertex(vertex) => {
                format!("vertex {vertex}, but there are {n}, counted from 0")
            }
            Defect::Shape(reason) => format!("it {reason}"),
        };
        Problem::new(format!("{name} {number}: {problem}"), CURE)
    })?;
    Ok(surface)
}

/// Format, elements and data of a file.
fn header(bytes: &[u8]) -> Result<(Format, Vec<Element>, Data<'_>), Problem> {
    // The newline of the first line applies to the whole header: the byte behind `end_header` may be data.
    let newline = bytes.iter().position(|byte| b"\r\n".contains(byte));
    let cr_alone = newline.is_some_and(|at| bytes[at] == b'\r' && bytes.get(at + 1) != Some(&b'\n'));
    let newline = if cr_alone { b'\r' } else { b'\n' };
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut at = 0;
    for (number, text) in bytes.split(|&byte| byte == newline).enumerate() {
        at += text.len() + 1;
        let here = (number + 1, text);
        let problem = || Problem::at_line(here, "does not belong there in the header", CURE);
        let words: Vec<&[u8]> = words(text).collect();
        match words.as_slice() {
            [b"ply"] if number == 0 => {}
            _ if number == 0 => {
                return Err(Problem::new("not a PLY file: its first line is not `ply`", CURE));
            }
            [] | [b"comment" | b"obj_info", ..] => {}
            [b"format", kind, _] if format.is_none() => {
                format = Some(match *kind {
                    b"ascii" => Format::Text,
                    b"binary_little_endian" => Format::LittleEndian,
                    b"binary_big_endian" => Format::BigEndian,
                    _ => return Err(problem()),
                });
            }
            [b"element", name, n] => {
                let n = self::number(n).map_err(|why| Problem::at_line(here, why, CURE))?;
                elements.push(Element { name: name.to_vec(), n, properties: Vec::new() });
            }
            [b"property", kind @ .., name] => {
                let element = elements.last_mut().ok_or_else(problem)?;
                let (count, kind) = match kind {
                    [b"list", count, kind] => {
                        let count = Type::named(count).filter(|count| count.is_whole());
                        (Some(count.ok_or_else(problem)?), kind)
                    }
                    [kind] => (None, kind),
                    _ => return Err(problem()),
                };
                let kind = Type::named(kind).ok_or_else(problem)?;
                element.properties.push(Property { name: name.to_vec(), count, kind });
            }
            [b"end_header"] => {
                let format = format.ok_or_else(|| Problem::new("the header has no `format`", CURE))?;
                check(&elements)?;
                let data = Data { rest: bytes.get(at..).unwrap_or_default(), line: number + 1 };
                return Ok((format, elements, data));
            }
            _ => return Err(problem()),
        }
    }
    Err(Problem::new("the header has no end: no `end_header`", CURE))
}

/// Refuses elements without vertices or lists, and unsupported elements with vertices.
fn check(elements: &[Element]) -> Result<(), Problem> {
    let count = |name: &str| {
        let named = elements.iter().filter(|element| element.name == name.as_bytes());
        named.count()
    };
    match count("vertex") {
        0 => return Err(Problem::new("no element `vertex`", CURE)),
        1 => {}
        n => return Err(Problem::new(format!("{n} elements `vertex`"), CURE)),
    }
    if count("face") + count("tristrips") == 0 {
        return Err(Problem::new("no element `face`", CURE));
    }
    for element in elements {
        let lists = ["vertex_indices", "vertex_index"].iter().find_map(|name| element.index(name));
        let lists = lists.map(|index| &element.properties[index]);
        let is_surface = element.name == b"face" || element.name == b"tristrips";
        let name = quoted(&element.name);
        match lists {
            Some(list) if is_surface && (list.count.is_none() || !list.kind.is_whole()) => {
                return Err(Problem::new(format!("{name} has no list `vertex_indices` of whole numbers"), CURE));
            }
            None if is_surface && element.n > 0 => {
                return Err(Problem::new(format!("{name} has no list `vertex_indices` of vertex numbers"), CURE));
            }
            Some(_) if !is_surface => {
                return Err(Problem::new(format!("elements {name} have vertices and are not read"), CURE));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Unread bytes behind the header.
struct Data<'a> {
    rest: &'a [u8],
    /// Number of the last line read.
    line: usize,
}

impl<'a> Data<'a> {
    fn read(&mut self, format: Format, element: &Element, number: u64, row: &mut Row) -> Result<(), Problem> {
        row.values.clear();
        row.ends.clear();
        let early = || {
            let name = String::from_utf8_lossy(&element.name);
            let problem = format!("the file ends too early: in or before {name} {number} of {}", element.n);
            Problem::new(problem, "export the mesh again: the file is damaged or cut off")
        };
        if format == Format::Text {
            let here = self.line().ok_or_else(early)?;
            return text_row(here, element, row);
        }
        let big_endian = format == Format::BigEndian;
        for property in &element.properties {
            let n = match property.count {
                None => 1.0,
                Some(kind) => self.binary(kind, big_endian).ok_or_else(early)?,
            };
            // A negative count has no values; one beyond the file ends it early.
            for _ in 0..n as u64 {
                row.values.push(self.binary(property.kind, big_endian).ok_or_else(early)?);
            }
            row.ends.push(row.values.len());
        }
        Ok(())
    }

    /// The next nonblank line.
    fn line(&mut self) -> Option<(usize, &'a [u8])> {
        loop {
            let (text, behind) = (!self.rest.is_empty()).then(|| split_line(self.rest))?;
            self.rest = behind;
            self.line += 1;
            if !text.trim_ascii().is_empty() {
                return Some((self.line, text));
            }
        }
    }

    fn binary(&mut self, kind: Type, big_endian: bool) -> Option<f64> {
        macro_rules! number {
            ($kind:ty) => {{
                let (bytes, rest) = self.rest.split_first_chunk()?;
                self.rest = rest;
                f64::from(<$kind>::from_le_bytes(little_endian(*bytes, big_endian)))
            }};
        }
        Some(match kind {
            Type::I8 => number!(i8),
            Type::U8 => number!(u8),
            Type::I16 => number!(i16),
            Type::U16 => number!(u16),
            Type::I32 => number!(i32),
            Type::U32 => number!(u32),
            Type::F32 => number!(f32),
            Type::F64 => number!(f64),
        })
    }

    /// Refuses bytes behind the last element.
    fn end(&self) -> Result<(), Problem> {
        let n = self.rest.trim_ascii().len();
        if n == 0 {
            return Ok(());
        }
        Err(Problem::new(
            format!("{n} bytes are left over behind the last element of the header"),
            "export the mesh again, one mesh a file, with the counts of its elements in the header",
        ))
    }
}

fn text_row(here: (usize, &[u8]), element: &Element, row: &mut Row) -> Result<(), Problem> {
    let problem = |problem: &str| Problem::at_line(here, problem, CURE);
    let mut words = words(here.1);
    for property in &element.properties {
        let mut value = |kind: Type| {
            let word = words.next().ok_or_else(|| problem("fewer values than the header declares"))?;
            // Rounds single precision once, as binary files do.
            let value: f64 = match kind {
                Type::F32 => number::<f32>(word).map(f64::from),
                _ => number(word),
            }
            .map_err(|why| problem(&why))?;
            if kind.is_whole() && value.fract() != 0.0 {
                return Err(problem("a broken number where a whole one belongs"));
            }
            Ok(value)
        };
        let n = property.count.map_or(Ok(1.0), &mut value)?;
        for _ in 0..n as u64 {
            row.values.push(value(property.kind)?);
        }
        row.ends.push(row.values.len());
    }
    if words.next().is_some() {
        return Err(problem("more values than the header declares"));
    }
    Ok(())
}
