//! Tetrahedra from Gmsh's MSH files, format 4.1, text and binary (Gmsh's manual, "MSH file format").
//!
//! The mshio crate (0.4.2) is not used. It replaces node numbers without gaps by the order of the file, which the format does
//! not promise. It also panics on the counts of damaged files.

use std::collections::HashMap;

use glam::DVec3;

use super::mesh_file::{Problem, little_endian};
use super::tet_read::RawTets;

/// Element kinds, as the mesh of a solid uses them.
enum Kind {
    Tetrahedron,
    /// A point, line, triangle or quadrilateral with this number of nodes.
    Lower(usize),
    /// An unsupported volume element, in words.
    Other(String),
}

/// Kind of an element type (Gmsh's manual, "Node ordering" and the table of "MSH file format version 1").
fn kind(element_type: i64) -> Kind {
    match element_type {
        4 => Kind::Tetrahedron,
        15 => Kind::Lower(1),
        1 => Kind::Lower(2),
        2 | 8 => Kind::Lower(3),
        3 | 26 => Kind::Lower(4),
        27 => Kind::Lower(5),
        9 | 28 => Kind::Lower(6),
        16 => Kind::Lower(8),
        10 | 20 => Kind::Lower(9),
        21 => Kind::Lower(10),
        22 => Kind::Lower(12),
        23 | 24 => Kind::Lower(15),
        25 => Kind::Lower(21),
        11 | 29 | 30 | 31 => Kind::Other("a tetrahedron of higher order".to_owned()),
        5 => Kind::Other("a hexahedron".to_owned()),
        6 => Kind::Other("a prism".to_owned()),
        7 => Kind::Other("a pyramid".to_owned()),
        12 | 17 | 92 | 93 => Kind::Other("a hexahedron of higher order".to_owned()),
        13 | 18 | 90 | 91 => Kind::Other("a prism of higher order".to_owned()),
        14 | 19 => Kind::Other("a pyramid of higher order".to_owned()),
        other => Kind::Other(format!("of type {other}")),
    }
}

/// Reads nodes and tetrahedra, and counts elements of lower dimension. `name` is the file's, for cures.
pub(super) fn read(bytes: &[u8], name: &str) -> Result<RawTets, Problem> {
    let mut file = Reader::new(bytes, name)?;
    let mut raw = RawTets { words: ["element", "node"], ..RawTets::default() };
    let mut numbers = HashMap::new();
    let (mut nodes_seen, mut elements_seen) = (false, false);
    while let Some(section) = file.section()? {
        match section {
            "Nodes" => {
                nodes_seen = true;
                read_nodes(&mut file, &mut raw, &mut numbers)?;
            }
            "Elements" if !nodes_seen => {
                return Err(file.problem("$Elements precedes $Nodes"));
            }
            "Elements" => {
                elements_seen = true;
                read_elements(&mut file, &mut raw, &numbers)?;
            }
            "MeshFormat" => {
                return Err(Problem {
                    cure: "give each mesh a file of its own".into(),
                    ..file.problem("a second mesh begins here")
                });
            }
            _ => file.skip_section(section)?,
        }
        file.end(section)?;
    }
    if !elements_seen {
        return Err(file.problem("the file ends without a section $Elements"));
    }
    Ok(raw)
}

fn read_nodes(file: &mut Reader, raw: &mut RawTets, numbers: &mut HashMap<u64, u32>) -> Result<(), Problem> {
    let n_blocks = file.size()?;
    // Number of nodes, smallest and largest tag, which the blocks repeat.
    for _ in 0..3 {
        file.size()?;
    }
    for _ in 0..n_blocks {
        let dimension = file.int()?;
        file.int()?;
        let parametric = file.int()? != 0;
        let n = file.size()?;
        for _ in 0..n {
            let tag = file.size()?;
            let number = u32::try_from(raw.node_names.len()).map_err(|_| file.problem("more than 2^32 nodes"))?;
            if numbers.insert(tag, number).is_some() {
                return Err(file.problem(format!("node {tag} is there twice")));
            }
            raw.node_names.push(tag);
        }
        for _ in 0..n {
            let x = DVec3::new(file.double()?, file.double()?, file.double()?);
            raw.nodes.push(x);
            for _ in 0..if parametric { dimension } else { 0 } {
                file.double()?;
            }
        }
    }
    Ok(())
}

fn read_elements(file: &mut Reader, raw: &mut RawTets, numbers: &HashMap<u64, u32>) -> Result<(), Problem> {
    let n_blocks = file.size()?;
    for _ in 0..3 {
        file.size()?;
    }
    for _ in 0..n_blocks {
        file.int()?;
        file.int()?;
        let element_type = file.int()?;
        let n = file.size()?;
        match kind(element_type) {
            Kind::Tetrahedron => {
                for _ in 0..n {
                    let tag = file.size()?;
                    let mut element = [0; 4];
                    for corner in &mut element {
                        let node = file.size()?;
                        *corner = *numbers.get(&node).ok_or_else(|| {
                            file.problem(format!("element {tag} has node {node}, which is not in $Nodes"))
                        })?;
                    }
                    raw.element_names.push(tag);
                    raw.elements.push(element);
                }
            }
            Kind::Lower(n_nodes) => {
                for _ in 0..n {
                    for _ in 0..1 + n_nodes {
                        file.size()?;
                    }
                    raw.ignored += 1;
                }
            }
            Kind::Other(_) if n == 0 => {}
            Kind::Other(what) => {
                let tag = file.size()?;
                return Err(Problem {
                    cure: format!(
                        "for elements of higher order: a file first.geo with `Merge \"{}\"; SetOrder 1; Save \"first.msh\";`, then \
                         gmsh first.geo -parse_and_exit; hexahedra, prisms and pyramids come from recombining and extruding: mesh \
                         without",
                        file.name
                    )
                    .into(),
                    ..file.problem(format!(
                        "element {tag} is {what}; only tetrahedra of 4 nodes are used"
                    ))
                });
            }
        }
    }
    Ok(())
}

/// Encoding of numbers in a binary file.
struct Binary {
    /// Bytes of a size, 4 or 8.
    size: usize,
    big_endian: bool,
}

/// Cursor over a file.
struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    /// `None` for text.
    binary: Option<Binary>,
    name: &'a str,
}

impl<'a> Reader<'a> {
    fn new(bytes: &'a [u8], name: &'a str) -> Result<Reader<'a>, Problem> {
        let mut file = Reader { bytes, at: 0, binary: None, name };
        if !matches!(file.section(), Ok(Some("MeshFormat"))) {
            return Err(Problem::new(
                "not a Gmsh file: it does not begin with $MeshFormat",
                "give a .msh file that Gmsh 4 wrote, or a .vtu file",
            ));
        }
        let version = file.token()?;
        if version != "4.1" {
            let new = name.strip_suffix(".msh").unwrap_or(name);
            return Err(Problem {
                cure: format!("convert it: gmsh {name} -save -format msh41 -o {new}_41.msh").into(),
                ..file.problem(format!("MSH format {version}, read is 4.1"))
            });
        }
        let (kind, size) = (file.token()?, file.token()?);
        let size = match size {
            "4" => 4,
            "8" => 8,
            other => return Err(file.problem(format!("sizes of {other} bytes, known are 4 and 8"))),
        };
        match kind {
            "0" => {}
            "1" => {
                file.line_end();
                let one = file.array::<4>()?;
                let big_endian = match (i32::from_be_bytes(one), i32::from_le_bytes(one)) {
                    (1, _) => true,
                    (_, 1) => false,
                    _ => return Err(file.problem("the byte order is unknown")),
                };
                file.binary = Some(Binary { size, big_endian });
            }
            other => {
                return Err(file.problem(format!("file type {other}: neither text (0) nor binary (1)")));
            }
        }
        file.end("MeshFormat")?;
        Ok(file)
    }

    /// An error at the current line of a text file or byte of a binary one.
    fn problem(&self, problem: impl Into<String>) -> Problem {
        let cure = "write the file again with Gmsh: it is damaged or incomplete";
        match self.binary {
            Some(_) => Problem::new(format!("{} (at byte {})", problem.into(), self.at), cure),
            None => {
                let before = &self.bytes[..self.at];
                let newlines = before.iter().filter(|&&byte| byte == b'\n').count();
                Problem { line: Some(newlines + 1), ..Problem::new(problem, cure) }
            }
        }
    }

    fn skip_space(&mut self) {
        let rest = &self.bytes[self.at..];
        let space = rest.iter().position(|byte| !byte.is_ascii_whitespace());
        self.at += space.unwrap_or(rest.len());
    }

    fn line_end(&mut self) {
        let rest = &self.bytes[self.at..];
        let newline = rest.iter().position(|&byte| byte == b'\n');
        self.at += newline.map_or(rest.len(), |newline| newline + 1);
    }

    fn token(&mut self) -> Result<&'a str, Problem> {
        self.skip_space();
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(u8::is_ascii_whitespace);
        let token = &rest[..end.unwrap_or(rest.len())];
        if token.is_empty() {
            return Err(self.problem("the file ends too early"));
        }
        let token = str::from_utf8(token).map_err(|_| self.problem("this is not text"))?;
        self.at += token.len();
        Ok(token)
    }

    /// Name of the section that begins here; `None` at the end of the file.
    fn section(&mut self) -> Result<Option<&'a str>, Problem> {
        self.skip_space();
        if self.at == self.bytes.len() {
            return Ok(None);
        }
        let token = self.token()?;
        let name = token.strip_prefix('$').filter(|name| !name.starts_with("End"));
        let name = name.ok_or_else(|| self.problem(format!("{token:?} where a section begins")))?;
        self.line_end();
        Ok(Some(name))
    }

    /// Skips to the end mark of a section.
    fn skip_section(&mut self, section: &str) -> Result<(), Problem> {
        let end = format!("$End{section}");
        let rest = &self.bytes[self.at..];
        let found = rest.windows(end.len()).position(|part| part == end.as_bytes());
        self.at += found.ok_or_else(|| self.problem(format!("{end} is missing")))?;
        Ok(())
    }

    /// Reads the end mark of a section.
    fn end(&mut self, section: &str) -> Result<(), Problem> {
        let token = self.token()?;
        if token.strip_prefix("$End") == Some(section) {
            return Ok(());
        }
        Err(self.problem(format!("{token:?} where $End{section} belongs")))
    }

    /// The little-endian bytes of the next number.
    fn array<const N: usize>(&mut self) -> Result<[u8; N], Problem> {
        let Some(&bytes) = self.bytes[self.at..].first_chunk::<N>() else {
            return Err(self.problem("the file ends too early"));
        };
        self.at += N;
        let big_endian = self.binary.as_ref().is_some_and(|binary| binary.big_endian);
        Ok(little_endian(bytes, big_endian))
    }

    fn parsed<T: std::str::FromStr>(&mut self, what: &str) -> Result<T, Problem> {
        let token = self.token()?;
        token.parse().map_err(|_| self.problem(format!("{token:?} where {what} belongs")))
    }

    fn int(&mut self) -> Result<i64, Problem> {
        match self.binary {
            None => self.parsed("a whole number"),
            Some(_) => Ok(i32::from_le_bytes(self.array()?).into()),
        }
    }

    fn size(&mut self) -> Result<u64, Problem> {
        match self.binary {
            None => self.parsed("a whole number"),
            Some(Binary { size: 4, .. }) => Ok(u32::from_le_bytes(self.array()?).into()),
            Some(_) => Ok(u64::from_le_bytes(self.array()?)),
        }
    }

    fn double(&mut self) -> Result<f64, Problem> {
        match self.binary {
            None => self.parsed("a number"),
            Some(_) => Ok(f64::from_le_bytes(self.array()?)),
        }
    }
}
