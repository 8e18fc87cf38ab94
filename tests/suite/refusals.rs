//! Every key of the format, misspelt, of a wrong type, not finite, too short: each is refused with the file, the line, the key and what
//! would be right. And scenes whose meshes make no solid.
//!
//! Lines and keys come from a scanner of the exemplars' text that shares no code with the reader.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;

use cutwater::Error;
use cutwater::geometry;
use cutwater::scene::Scene;
use cutwater::scene::schema::EXEMPLARS;
use cutwater::sim;

/// A `key = value` of a scene's text.
#[derive(Debug)]
struct Spot {
    /// From 1.
    line: usize,
    /// Dotted, with indices.
    path: String,
    key: Range<usize>,
    value: Range<usize>,
}

/// All keys of a text in which every value stands on one line.
fn spots(text: &str) -> Vec<Spot> {
    let mut spots = Vec::new();
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    let (mut table, mut start) = (String::new(), 0);
    for (number, line) in text.split('\n').enumerate() {
        if let Some(header) = line.strip_prefix('[') {
            let list = header.starts_with('[');
            let names: Vec<&str> = header.trim_matches(['[', ']']).split('.').collect();
            table = String::new();
            for (at, name) in names.iter().enumerate() {
                table = join(&table, name);
                let last = at + 1 == names.len();
                let count = counts.entry(table.clone()).or_default();
                *count += usize::from(last && list);
                if *count > 0 {
                    table += &format!("[{}]", *count - 1);
                }
            }
        } else if line.contains('=') && !line.starts_with('#') {
            let mut scanner = Scanner { text, at: start, line: number + 1, spots: &mut spots };
            scanner.pair(&table);
        }
        start += line.len() + 1;
    }
    spots
}

fn join(table: &str, key: &str) -> String {
    match table {
        "" => key.to_owned(),
        _ => format!("{table}.{key}"),
    }
}

struct Scanner<'a> {
    text: &'a str,
    at: usize,
    line: usize,
    spots: &'a mut Vec<Spot>,
}

impl Scanner<'_> {
    fn peek(&self) -> u8 {
        self.text.as_bytes().get(self.at).copied().unwrap_or(b'\n')
    }

    fn skip(&mut self, what: &[u8]) {
        while what.contains(&self.peek()) {
            self.at += 1;
        }
    }

    fn pair(&mut self, table: &str) {
        let start = self.at;
        while self.peek().is_ascii_alphanumeric() || self.peek() == b'_' {
            self.at += 1;
        }
        let key = start..self.at;
        self.skip(b" =");
        let path = join(table, &self.text[key.clone()]);
        let (spot, start) = (self.spots.len(), self.at);
        self.spots.push(Spot { line: self.line, path: path.clone(), key, value: 0..0 });
        self.value(&path);
        self.spots[spot].value = start..self.at;
    }

    fn value(&mut self, path: &str) {
        match self.peek() {
            b'{' => {
                self.at += 1;
                self.skip(b" ,");
                while self.peek() != b'}' {
                    self.pair(path);
                    self.skip(b" ,");
                }
                self.at += 1;
            }
            b'[' => {
                self.at += 1;
                self.skip(b" ,");
                for index in 0.. {
                    if self.peek() == b']' {
                        break;
                    }
                    self.value(&format!("{path}[{index}]"));
                    self.skip(b" ,");
                }
                self.at += 1;
            }
            b'"' => {
                self.at += 1;
                while self.peek() != b'"' {
                    self.at += 1;
                }
                self.at += 1;
            }
            _ => {
                while !b" ,]}\n".contains(&self.peek()) {
                    self.at += 1;
                }
            }
        }
    }
}

/// A folder with the files that the exemplars name; the reader of scenes only hashes them.
fn with_meshes() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["liquid.obj", "obstacle.stl", "solid.vtu", "solid.ply"] {
        fs::write(folder.path().join(name), "").unwrap();
    }
    folder
}

#[test]
fn every_key_is_refused_in_its_line_and_by_its_name() {
    let folder = with_meshes();
    let file = folder.path().join("scene.toml");
    let mut n = 0;
    for text in EXEMPLARS {
        let spots = spots(text);
        assert!(spots.iter().all(|spot| !spot.value.is_empty()), "{spots:?}");
        for spot in &spots {
            let (key, value) = (&text[spot.key.clone()], &text[spot.value.clone()]);
            let mut refuse = |range: &Range<usize>, with: &str, path: &str, parts: &[&str]| {
                let changed = format!("{}{with}{}", &text[..range.start], &text[range.end..]);
                let error = Scene::parse(&file, &changed, &[], 1.0).expect_err(path);
                let message = error.to_string();
                let start = format!("{}:{}: {path}: ", file.display(), spot.line);
                let line = changed.lines().nth(spot.line - 1).unwrap();
                assert!(message.starts_with(&start), "{line}\n{message}\nnot {start}");
                for part in parts.iter().chain(&["\n  cure: "]) {
                    assert!(message.contains(part), "{line}\n{message}\nhas no {part}");
                }
                assert_eq!(error.exit_code(), 2);
                n += 1;
            };
            let misspelt = format!("{key}q");
            let path = spot.path.strip_suffix(key).unwrap();
            let meant = format!("did you mean `{key}`? the keys here are ");
            refuse(&spot.key, &misspelt, &format!("{path}{misspelt}"), &["unknown key", &meant]);
            let is_boolean = ["true", "false"].contains(&value);
            let (wrong, told) = match is_boolean {
                true => ("\"yes\"", "is the text \"yes\""),
                false => ("true", "is true"),
            };
            refuse(&spot.value, wrong, &spot.path, &[told, "cure: write "]);
            refuse(&spot.value, "1979-05-27", &spot.path, &["is a date", "cure: write "]);
            let is_number = |text: &str| text.parse::<f64>().is_ok();
            if is_number(value) {
                refuse(&spot.value, "nan", &spot.path, &["NaN"]);
                refuse(&spot.value, "[1]", &spot.path, &["a list of 1"]);
            }
            let items = value.strip_prefix('[').and_then(|value| value.strip_suffix(']'));
            let items: Vec<&str> = items.map_or(Vec::new(), |items| items.split(", ").collect());
            if items.len() > 1 && items.iter().all(|item| is_number(item)) {
                let len = items.len();
                let fewer = format!("[{}]", items[1..].join(", "));
                let wanted = format!("a list of {len} numbers");
                refuse(&spot.value, &fewer, &spot.path, &[&format!("is a list of {}", len - 1), &wanted]);
                let infinite = format!("[{}, -inf]", items[1..].join(", "));
                refuse(&spot.value, &infinite, &format!("{}[{}]", spot.path, len - 1), &["-inf"]);
            }
        }
    }
    assert!(n > 800, "{n} cases");
}

/// The smallest closed surface: corners and triangles of a tetrahedron, seen from outside.
const CORNERS: [&str; 4] = ["0 0 0", "1 0 0", "0 1 0", "0 0 1"];
const SIDES: [[usize; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];

fn obj(sides: &[[usize; 3]]) -> String {
    let corners = CORNERS.iter().map(|x| format!("v {x}\n"));
    let sides = sides.iter().map(|[a, b, c]| format!("f {} {} {}\n", a + 1, b + 1, c + 1));
    corners.chain(sides).collect()
}

fn stl(sides: &[[usize; 3]]) -> String {
    let facet = |side: &[usize; 3]| {
        let corners: String = side.iter().map(|&corner| format!("vertex {}\n", CORNERS[corner])).collect();
        format!("facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n")
    };
    format!("solid t\n{}endsolid t\n", sides.iter().map(facet).collect::<String>())
}

fn ply(sides: &[[usize; 3]]) -> String {
    let head = format!(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face {}\nproperty list uchar int \
         vertex_indices\nend_header\n",
        sides.len()
    );
    let faces = sides.iter().map(|[a, b, c]| format!("3 {a} {b} {c}\n"));
    head + &CORNERS.join("\n") + "\n" + &faces.collect::<String>()
}

fn msh(version: &str, corners: [usize; 4]) -> String {
    let [a, b, c, d] = corners.map(|corner| corner + 1);
    format!(
        "$MeshFormat\n{version} 0 8\n$EndMeshFormat\n$Nodes\n1 4 1 4\n3 1 0 4\n1\n2\n3\n4\n{}\n$EndNodes\n\
         $Elements\n1 1 1 1\n3 1 4 1\n1 {a} {b} {c} {d}\n$EndElements\n",
        CORNERS.join("\n")
    )
}

fn vtu(kind: u8, corners: &str) -> String {
    let array = |name: &str, kind: &str, n: usize, values: &str| {
        format!(
            "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{n}\" format=\"ascii\">{values}</DataArray>\n"
        )
    };
    let n = corners.split_whitespace().count();
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\">\n<UnstructuredGrid>\n\
         <Piece NumberOfPoints=\"4\" NumberOfCells=\"1\">\n<Points>\n{}</Points>\n<Cells>\n{}{}{}</Cells>\n</Piece>\n\
         </UnstructuredGrid>\n</VTKFile>\n",
        array("Points", "Float64", 3, &CORNERS.join(" ")),
        array("connectivity", "Int64", 1, corners),
        array("offsets", "Int64", 1, &n.to_string()),
        array("types", "UInt8", 1, &kind.to_string())
    )
}

/// The start of a text, without its last part.
fn cut(text: &str, share: f64) -> String {
    text[..(share * text.len() as f64) as usize].to_owned()
}

const HEAD: &str = "[domain]\nsize = [4, 4, 4]\ncells = [8, 8, 8]\n[time]\nduration = 1\n";
const POOL: &str = "[[liquid.region]]\nbox = { min = [0, 0, 0], max = [4, 1, 4] }\n";

/// Whatever a run does with the meshes of a scene before its first sub-step.
fn prepare(file: &str, contents: &str) -> Result<(), Error> {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join(file), contents).unwrap();
    let solid = |mesh: &str| {
        format!(
            "{HEAD}[[solid]]\nname = \"a\"\nmesh = {{ {mesh} }}\nplacement = {{ translate = [1, 1, 1] }}\ndensity = 1\nyoung = 1e5\npoisson = 0.3\n"
        )
    };
    let text = match file.rsplit('.').next() {
        Some("msh" | "vtu") => solid(&format!("file = \"{file}\"")),
        _ => format!(
            "{HEAD}{POOL}[[obstacle]]\nmesh = {{ file = \"{file}\" }}\nplacement = {{ translate = [1, 1, 1] }}\n"
        ),
    };
    let scene = Scene::parse(&folder.path().join("scene.toml"), &text, &[], 1.0)?;
    sim::solids_of(&scene)?;
    geometry::obstacle_cut(&scene, &scene.grid())?;
    if matches!(file.rsplit('.').next(), Some("obj" | "stl" | "ply")) {
        // As liquid, and filled as a solid, it is refused with the same words.
        let said = |text: String| {
            let scene = Scene::parse(&folder.path().join("scene.toml"), &text, &[], 1.0).unwrap();
            sim::reference_path(&scene).map(|_| ())
        };
        said(format!("{HEAD}[[liquid.region]]\nmesh = {{ file = \"{file}\" }}\n"))?;
        said(solid(&format!("surface = {{ file = \"{file}\", cell_size = 0.5 }}")))?;
    }
    Ok(())
}

#[test]
fn meshes_that_make_no_solid_are_refused_where_a_scene_names_them() {
    for (file, sound) in [
        ("a.obj", obj(&SIDES)),
        ("a.stl", stl(&SIDES)),
        ("a.ply", ply(&SIDES)),
        ("a.msh", msh("4.1", [0, 1, 2, 3])),
        ("a.vtu", vtu(10, "0 1 2 3")),
    ] {
        if let Err(error) = prepare(file, &sound) {
            panic!("{file}: {error}");
        }
    }
    let open = &SIDES[..3];
    let turned = [SIDES[0], SIDES[1], SIDES[2], [0, 2, 3]];
    let inverted = SIDES.map(|[a, b, c]| [a, c, b]);
    let flat = [[0, 1, 1], [0, 1, 1]];
    #[rustfmt::skip] // one case a line
    let cases: Vec<(&str, String, &[&str])> = vec![
        ("a.obj", String::new(), &["the file is empty: no triangles", "export the mesh again"]),
        ("a.obj", cut(&obj(&SIDES), 0.8), &["a.obj:7: `f 2`: ", "fewer than three different corners"]),
        ("a.obj", obj(open), &["not closed: the edge from [0, 0, 0] to [0, 1, 0] belongs to triangle 1 alone", "fill the holes"]),
        ("a.obj", obj(&turned), &["triangles 1 and 4 use the edge", "in the same direction", "consistent"]),
        ("a.obj", obj(&flat), &["a.obj:5: `f 1 2 2`: ", "fewer than three different corners"]),
        ("a.obj", obj(&inverted), &["inverted: the normals point inwards", "flip the normals"]),
        ("a.obj", obj(&SIDES).replace("f 1 2 4", "f 1 2 9"), &["a.obj:6: `f 1 2 9`: ", "out of bounds", "existing vertices"]),
        ("a.obj", obj(&SIDES).replace("v 1 0 0", "v 1 nil 0"), &["a.obj:2: `v 1 nil 0`: position", "three coordinates"]),
        ("a.obj", "v 1 nil 0".to_owned(), &["a.obj:1: `v 1 nil 0`: position"]),
        ("a.obj", "v 0 0 0\nv 1 \u{1b}[7mnil 0".to_owned(), &["a.obj:2: `v 1 \u{fffd}[7mnil 0`: position"]),
        ("a.obj", obj(&SIDES).replace("v 1 0 0", "v 1e308 0 0"), &["triangle 1 has the corner [", "at most 1e60 m"]),
        ("a.obj", obj(&SIDES).replace("v 1 0 0", "v inf 0 0"), &["triangle 1 has the corner [inf, 0, 0]", "finite numbers"]),
        ("a.stl", String::new(), &["the file is empty: no triangles"]),
        ("a.stl", "hello".to_owned(), &["not an STL file", "export the surface again"]),
        ("a.stl", cut(&stl(&SIDES), 0.6), &["the file ends in facet 3, where a coordinate belongs", "export the surface again"]),
        ("a.stl", format!("{}\u{4}\0\0\0{}", "\0".repeat(80), "\0".repeat(70)), &["the file ends in or before facet 2", "export the surface again"]),
        ("a.stl", stl(open), &["not closed", "fill the holes"]),
        ("a.stl", stl(&inverted), &["inverted", "flip the normals"]),
        ("a.stl", stl(&SIDES).replace("vertex 1 0 0", "vertex 1 0 x"), &["facet 1: ", "export the surface again"]),
        ("a.ply", String::new(), &["the file is empty: no triangles"]),
        ("a.ply", cut(&ply(&SIDES), 0.9), &["a.ply:15: `3 0`: fewer values than the header declares", "vertex_indices"]),
        ("a.ply", ply(&SIDES).replace("ply\n", "plx\n"), &["not a PLY file: its first line is not `ply`"]),
        ("a.ply", ply(&SIDES).replace("element face", "elements face"), &["a.ply:7: `elements face 4`: does not belong there in the header", "vertex_indices"]),
        ("a.ply", ply(&SIDES).replace("element vertex 4\n", ""), &["a.ply:3: `property float x`: does not belong there"]),
        ("a.ply", ply(&SIDES).replace("end_header\n", ""), &["a.ply:9: `0 0 0`: does not belong there in the header"]),
        ("a.ply", ply(&SIDES).replace("3 0 3 2\n", ""), &["the file ends too early: ", "face"]),
        ("a.ply", cut(&ply(&SIDES), 0.5), &["a.ply:8: `p`: does not belong there in the header"]),
        ("a.ply", ply(&SIDES).replace("ascii", "binary_little_endian").replace("0 0 0\n", "\u{1b}[7m\n"), &["the file ends too early: "]),
        ("a.ply", ply(open), &["not closed", "fill the holes"]),
        ("a.ply", ply(&inverted), &["inverted", "flip the normals"]),
        ("a.ply", ply(&SIDES).replace("3 0 2 1", "3 0 2 7"), &["face 1: vertex 7, but there are 4"]),
        ("a.msh", String::new(), &["not a Gmsh file: it does not begin with $MeshFormat"]),
        ("a.msh", "hello".to_owned(), &["not a Gmsh file", "give a .msh file that Gmsh 4 wrote"]),
        ("a.msh", msh("2.2", [0, 1, 2, 3]), &["a.msh:2: MSH format 2.2, read is 4.1", "-format msh41"]),
        ("a.msh", cut(&msh("4.1", [0, 1, 2, 3]), 0.7), &["a.msh:16: $EndEle is missing", "damaged or incomplete"]),
        ("a.msh", msh("4.1", [0, 1, 2, 2]), &["element 1 has node 3 twice", "remove collapsed elements"]),
        ("a.msh", msh("4.1", [0, 1, 2, 3]).replace("0 0 1\n$EndNodes", "1 1 0\n$EndNodes"), &["element 1 with the corners", "has no volume", "flat elements"]),
        ("a.msh", msh("4.1", [0, 1, 2, 8]), &["a.msh:19: element 1 has node 9, which is not in $Nodes"]),
        ("a.vtu", String::new(), &["a.vtu:1: not an XML file", "ParaView"]),
        ("a.vtu", cut(&vtu(10, "0 1 2 3"), 0.7), &["a.vtu:1: not an XML file", "ParaView"]),
        ("a.vtu", vtu(12, "0 1 2 3 0 1 2 3"), &["a.vtu:11: cell 0 is a hexahedron", "Tetrahedralize"]),
        ("a.vtu", vtu(10, "0 1 2 2"), &["cell 0 has point 2 twice", "remove collapsed elements"]),
        ("a.vtu", vtu(10, "0 1 2 4"), &["a.vtu:9: cell 0 has point 4, but there are 4"]),
        ("a.vtu", vtu(10, "0 1 2 3").replace("UnstructuredGrid", "PolyData"), &["a.vtu:2: PolyData, not an UnstructuredGrid"]),
    ];
    let n = cases.len();
    let mut wrong = Vec::new();
    for (file, contents, parts) in cases {
        let error = prepare(file, &contents).expect_err(&contents);
        let message = error.to_string();
        assert_eq!(error.exit_code(), 2, "{message}");
        let controls = |c: char| c.is_control() && c != '\n';
        assert!(!message.contains(controls), "{message:?}");
        for part in parts.iter().chain(&[file, "cure: "]) {
            if !message.contains(part) {
                wrong.push(format!("{message}\nhas no {part}, of\n{contents}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n\n"));
    assert!(n > 25, "{n}");
}

#[test]
fn a_broken_mesh_of_a_region_is_told_with_where_it_is_named() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.obj"), "v 0 0\n").unwrap();
    let text = format!("{HEAD}{POOL}[[liquid.region]]\nmesh = {{ file = \"a.obj\" }}\n");
    let scene = Scene::parse(&folder.path().join("scene.toml"), &text, &[], 1.0).unwrap();
    let message = sim::reference_path(&scene).unwrap_err().to_string();
    let line = HEAD.lines().count() + POOL.lines().count() + 1;
    for told in [
        &format!("scene.toml:{line}: liquid.region[1]: "),
        "a.obj:1: `v 0 0`: a position of fewer than three coordinates",
    ] {
        assert!(message.contains(told), "{message}\nhas no {told}");
    }
}
