//! Tetrahedra from VTK's XML files of unstructured grids (.vtu): text, base64 and raw appended data, plain or with zlib (VTK's
//! manual, "XML file formats").
//!
//! vtkio, which writes these files here, cannot read raw appended data, ParaView's default, and panics on truncated data.

use std::io::Read;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use flate2::read::ZlibDecoder;
use glam::DVec3;
use roxmltree::{Document, Node};

use super::mesh_file::{Problem, little_endian};
use super::tet_read::RawTets;

const TETRAHEDRON: i64 = 10;

/// Cells of fewer than three dimensions: vertices, lines, triangles, quadrilaterals and so on, also of higher order.
const LOWER: [i64; 25] = [1, 2, 3, 4, 5, 6, 7, 8, 9, 21, 22, 23, 28, 30, 31, 34, 35, 36, 51, 68, 69, 70, 75, 76, 77];

const TETRAHEDRALIZE: &str = "in ParaView apply the filter Tetrahedralize (for cells of higher order before it Linearize), and save the result as .vtu";

/// Reads the points and tetrahedra of all pieces, and counts cells of lower dimension.
pub(super) fn read(bytes: &[u8]) -> Result<RawTets, Problem> {
    let (head, appended) = split(bytes);
    let document = Document::parse(&head).map_err(|problem| Problem {
        line: Some(problem.pos().row as usize),
        ..Problem::new(
            format!("not an XML file: {problem}"),
            "give a .vtu file that ParaView or another program wrote; older .vtk files can be saved as .vtu there",
        )
    })?;
    let root = document.root_element();
    let file = File::new(&document, root, appended)?;
    if !bytes.trim_ascii_end().ends_with(b"</VTKFile>") && !appended.is_empty() {
        return Err(file.problem(root, "the file does not end with </VTKFile>"));
    }
    let grid =
        child(root, "UnstructuredGrid").ok_or_else(|| file.problem(root, "no UnstructuredGrid, so no tetrahedra"))?;
    let mut raw = RawTets { words: ["cell", "point"], ..RawTets::default() };
    let mut n_cells_before = 0;
    for piece in grid.children().filter(|node| node.has_tag_name("Piece")) {
        n_cells_before += file.read_piece(piece, n_cells_before, &mut raw)?;
    }
    raw.node_names = (0..raw.nodes.len() as u64).collect();
    Ok(raw)
}

/// The XML without its AppendedData, and those data from behind their underscore on: raw bytes are no XML.
fn split(bytes: &[u8]) -> (String, &[u8]) {
    let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
    let find = |from: usize, what: &[u8]| {
        let at = bytes[from..].windows(what.len()).position(|part| part == what);
        at.map(|at| from + at)
    };
    let cut = || {
        let tag = find(0, b"<AppendedData")?;
        let open = find(tag, b">")?;
        let start = find(open, b"_")?;
        Some((open, start))
    };
    match cut() {
        Some((open, start)) => {
            let head = text(&bytes[..=open]) + "</AppendedData></VTKFile>";
            (head, &bytes[start + 1..])
        }
        None => (text(bytes), &[]),
    }
}

fn cell_name(kind: i64) -> String {
    match kind {
        24 | 71 | 78 => "a tetrahedron of higher order".to_owned(),
        11 | 12 => "a hexahedron".to_owned(),
        13 => "a prism".to_owned(),
        14 => "a pyramid".to_owned(),
        other => format!("of type {other}"),
    }
}

fn child<'a>(node: Node<'a, 'a>, name: &str) -> Option<Node<'a, 'a>> {
    node.children().find(|child| child.has_tag_name(name))
}

enum Values {
    Whole(Vec<i64>),
    Real(Vec<f64>),
}

/// Encoding of the whole file.
struct File<'a> {
    document: &'a Document<'a>,
    big_endian: bool,
    /// Bytes of a header number.
    header: usize,
    zlib: bool,
    appended: &'a [u8],
    appended_base64: bool,
}

impl<'a> File<'a> {
    fn new(document: &'a Document<'a>, root: Node<'a, 'a>, appended: &'a [u8]) -> Result<File<'a>, Problem> {
        let encoding = child(root, "AppendedData").and_then(|node| node.attribute("encoding"));
        let mut file = File {
            document,
            big_endian: root.attribute("byte_order") == Some("BigEndian"),
            header: 4,
            zlib: false,
            appended,
            appended_base64: encoding == Some("base64"),
        };
        match root.attribute("type") {
            Some("UnstructuredGrid") => {}
            kind => {
                let kind = kind.unwrap_or("no VTKFile");
                return Err(file.problem(root, format!("{kind}, not an UnstructuredGrid")));
            }
        }
        match root.attribute("header_type") {
            None | Some("UInt32") => {}
            Some("UInt64") => file.header = 8,
            Some(other) => return Err(file.problem(root, format!("header_type {other}"))),
        }
        match root.attribute("compressor") {
            None | Some("") => {}
            Some("vtkZLibDataCompressor") => file.zlib = true,
            Some(other) => {
                return Err(Problem {
                    cure: "save the file with compressor ZLib or none".into(),
                    ..file.problem(root, format!("compressor {other}"))
                });
            }
        }
        Ok(file)
    }

    /// An error at the line of a node.
    fn problem(&self, node: Node, problem: impl Into<String>) -> Problem {
        let line = self.document.text_pos_at(node.range().start).row;
        Problem {
            line: Some(line as usize),
            ..Problem::new(
                problem,
                "save the mesh again as a .vtu file of an unstructured grid: this one is damaged or incomplete",
            )
        }
    }

    /// Reads a piece; returns its number of cells.
    fn read_piece(&self, piece: Node<'a, 'a>, n_cells_before: u64, raw: &mut RawTets) -> Result<u64, Problem> {
        let [n_points, n_cells] = ["NumberOfPoints", "NumberOfCells"].map(|name| {
            let count = piece.attribute(name).and_then(|count| count.trim().parse().ok());
            count.ok_or_else(|| self.problem(piece, format!("no {name} of this piece")))
        });
        let (n_points, n_cells): (usize, usize) = (n_points?, n_cells?);
        let points = self.points(piece, n_points)?;
        let cells = self.part(piece, "Cells")?;
        let (connectivity_node, connectivity) = self.cell_array(cells, "connectivity")?;
        let (offsets_node, offsets) = self.cell_array(cells, "offsets")?;
        let (types_node, types) = self.cell_array(cells, "types")?;
        for (node, array) in [(offsets_node, &offsets), (types_node, &types)] {
            if array.len() != n_cells {
                let n = array.len();
                return Err(self.problem(node, format!("{n} values for {n_cells} cells")));
            }
        }
        let first = raw.nodes.len();
        raw.nodes.extend(points);
        let mut start = 0;
        for (number, (&end, &kind)) in (n_cells_before..).zip(offsets.iter().zip(&types)) {
            let corners = usize::try_from(end).ok().and_then(|end| {
                let corners = connectivity.get(start..end)?;
                start = end;
                Some(corners)
            });
            let corners = corners.ok_or_else(|| {
                self.problem(offsets_node, format!("cell {number} ends at {end}, outside of connectivity"))
            })?;
            match (kind, corners) {
                (TETRAHEDRON, &[a, b, c, d]) => {
                    let mut element = [0; 4];
                    for (node, corner) in element.iter_mut().zip([a, b, c, d]) {
                        let known = usize::try_from(corner).ok().filter(|&at| at < n_points);
                        let known = known.and_then(|at| u32::try_from(first + at).ok());
                        *node = known.ok_or_else(|| {
                            let problem =
                                format!("cell {number} has point {corner}, but there are {n_points}, counted from 0");
                            self.problem(connectivity_node, problem)
                        })?;
                    }
                    raw.elements.push(element);
                    raw.element_names.push(number);
                }
                (TETRAHEDRON, corners) => {
                    let n = corners.len();
                    return Err(self.problem(offsets_node, format!("cell {number} is a tetrahedron with {n} points")));
                }
                (kind, _) if LOWER.contains(&kind) => raw.ignored += 1,
                (kind, _) => {
                    let cell = format!("cell {number} is {}", cell_name(kind));
                    let problem = format!("{cell}; only tetrahedra of 4 points are used");
                    return Err(Problem { cure: TETRAHEDRALIZE.into(), ..self.problem(types_node, problem) });
                }
            }
        }
        if start != connectivity.len() {
            let n = connectivity.len() - start;
            return Err(self.problem(connectivity_node, format!("{n} numbers are left over behind the last cell")));
        }
        Ok(n_cells as u64)
    }

    fn part(&self, piece: Node<'a, 'a>, name: &str) -> Result<Node<'a, 'a>, Problem> {
        child(piece, name).ok_or_else(|| self.problem(piece, format!("no {name} in this piece")))
    }

    fn points(&self, piece: Node<'a, 'a>, n: usize) -> Result<Vec<DVec3>, Problem> {
        let points = self.part(piece, "Points")?;
        let points = child(points, "DataArray").ok_or_else(|| self.problem(points, "no DataArray of points"))?;
        let coordinates = self.real(points)?;
        let (positions, rest) = coordinates.as_chunks::<3>();
        if positions.len() != n || !rest.is_empty() {
            let problem = format!("{} coordinates of {n} points", coordinates.len());
            return Err(self.problem(points, problem));
        }
        Ok(positions.iter().map(|&x| DVec3::from_array(x)).collect())
    }

    /// An integer array of the cells, with its node.
    fn cell_array(&self, cells: Node<'a, 'a>, name: &str) -> Result<(Node<'a, 'a>, Vec<i64>), Problem> {
        let mut arrays = cells.children().filter(|node| node.has_tag_name("DataArray"));
        let node = arrays.find(|node| node.attribute("Name") == Some(name));
        let node = node.ok_or_else(|| self.problem(cells, format!("no array {name} of the cells")))?;
        Ok((node, self.whole(node)?))
    }

    fn whole(&self, node: Node<'a, 'a>) -> Result<Vec<i64>, Problem> {
        match self.values(node)? {
            Values::Whole(values) => Ok(values),
            Values::Real(_) => Err(self.problem(node, "real numbers where whole ones belong")),
        }
    }

    fn real(&self, node: Node<'a, 'a>) -> Result<Vec<f64>, Problem> {
        match self.values(node)? {
            Values::Real(values) => Ok(values),
            Values::Whole(values) => Ok(values.into_iter().map(|value| value as f64).collect()),
        }
    }

    fn values(&self, node: Node<'a, 'a>) -> Result<Values, Problem> {
        let kind = node.attribute("type").unwrap_or("Float64");
        if self.numbers(&[], kind).is_none() {
            return Err(self.problem(node, format!("data of type {kind}")));
        }
        let real = kind.starts_with("Float");
        let text = || -> String {
            let parts = node.children().filter_map(|child| child.text());
            parts.collect()
        };
        let bytes = match node.attribute("format") {
            Some("ascii") => {
                let text = text();
                let tokens = text.split_ascii_whitespace();
                return if real {
                    let values: Result<_, _> = tokens.map(str::parse).collect();
                    values.map(Values::Real).map_err(|_| self.problem(node, "this is not a list of numbers"))
                } else {
                    let values: Result<_, _> = tokens.map(str::parse).collect();
                    values.map(Values::Whole).map_err(|_| self.problem(node, "this is not a list of whole numbers"))
                };
            }
            Some("binary") => {
                let mut text = text().into_bytes();
                text.retain(|byte| !byte.is_ascii_whitespace());
                let decoded = self.decode(&text, true);
                if let Some((_, used)) = decoded
                    && used < text.len()
                {
                    let n = text.len() - used;
                    let problem = format!("{n} characters are left over behind these data");
                    return Err(self.problem(node, problem));
                }
                decoded
            }
            Some("appended") => {
                let offset = node.attribute("offset").and_then(|offset| offset.parse().ok());
                let data = offset.and_then(|offset: usize| self.appended.get(offset..));
                data.and_then(|data| self.decode(data, self.appended_base64))
            }
            other => {
                let other = other.unwrap_or("none");
                return Err(self.problem(node, format!("data in the format {other}")));
            }
        };
        let (bytes, _) = bytes.ok_or_else(|| self.problem(node, "these data cannot be decoded, or end too early"))?;
        self.numbers(&bytes, kind)
            .ok_or_else(|| self.problem(node, format!("{} bytes of data of type {kind}", bytes.len())))
    }

    /// Bytes of the array at the start of `data`, and the length of its encoding: a header with sizes, then the values,
    /// plain or in blocks.
    fn decode(&self, data: &[u8], base64: bool) -> Option<(Vec<u8>, usize)> {
        let encoded = |n: usize| if base64 { n.div_ceil(3) * 4 } else { n };
        // The first `end` bytes, which are one piece of base64.
        let take = |from: &[u8], end: usize| -> Option<Vec<u8>> {
            if base64 {
                let encoded = from.get(..end.div_ceil(3).checked_mul(4)?)?;
                let mut bytes = BASE64_STANDARD.decode(encoded).ok()?;
                bytes.truncate(end);
                (bytes.len() == end).then_some(bytes)
            } else {
                Some(from.get(..end)?.to_vec())
            }
        };
        let first = self.size(&take(data, self.header)?)?;
        if !self.zlib {
            let end = self.header.checked_add(first)?;
            let all = take(data, end)?;
            return Some((all[self.header..].to_vec(), encoded(end)));
        }
        // Number of blocks, size of a block, size of a smaller last block, compressed sizes.
        let header_bytes = first.checked_add(3)?.checked_mul(self.header)?;
        let header = take(data, header_bytes)?;
        let sizes: Option<Vec<usize>> = header.chunks(self.header).map(|size| self.size(size)).collect();
        let sizes = sizes?;
        let (&[n_blocks, whole, last], compressed) = sizes.split_first_chunk::<3>()?;
        let behind = encoded(header_bytes);
        let total = compressed.iter().try_fold(0_usize, |sum, &size| sum.checked_add(size))?;
        let packed = take(data.get(behind..)?, total)?;
        let mut bytes = Vec::new();
        let mut start = 0;
        for (block, &size) in compressed.iter().enumerate() {
            let expected = if block + 1 == n_blocks && last > 0 { last } else { whole };
            let before = bytes.len();
            let packed = &packed[start..start + size];
            // Damaged sizes must not exhaust the memory.
            let limit = (expected as u64).saturating_add(1);
            ZlibDecoder::new(packed).take(limit).read_to_end(&mut bytes).ok()?;
            if bytes.len() - before != expected {
                return None;
            }
            start += size;
        }
        Some((bytes, behind + encoded(total)))
    }

    fn size(&self, bytes: &[u8]) -> Option<usize> {
        let size = if let Ok(bytes) = <[u8; 4]>::try_from(bytes) {
            u32::from_le_bytes(little_endian(bytes, self.big_endian)).into()
        } else {
            let bytes = <[u8; 8]>::try_from(bytes).ok()?;
            u64::from_le_bytes(little_endian(bytes, self.big_endian))
        };
        usize::try_from(size).ok()
    }

    /// Numbers of a VTK type; `None` for a remainder or an unknown type.
    fn numbers(&self, bytes: &[u8], kind: &str) -> Option<Values> {
        macro_rules! numbers {
            ($kind:ty, $values:expr, $into:ty) => {{
                let (numbers, rest) = bytes.as_chunks::<{ size_of::<$kind>() }>();
                let numbers =
                    numbers.iter().map(|&bytes| <$kind>::from_le_bytes(little_endian(bytes, self.big_endian)) as $into);
                rest.is_empty().then(|| $values(numbers.collect()))
            }};
        }
        match kind {
            "Int8" => numbers!(i8, Values::Whole, i64),
            "UInt8" => numbers!(u8, Values::Whole, i64),
            "Int16" => numbers!(i16, Values::Whole, i64),
            "UInt16" => numbers!(u16, Values::Whole, i64),
            "Int32" => numbers!(i32, Values::Whole, i64),
            "UInt32" => numbers!(u32, Values::Whole, i64),
            "Int64" => numbers!(i64, Values::Whole, i64),
            "UInt64" => numbers!(u64, Values::Whole, i64),
            "Float32" => numbers!(f32, Values::Real, f64),
            "Float64" => numbers!(f64, Values::Real, f64),
            _ => None,
        }
    }
}
