//! Files of tetrahedra: what Gmsh and VTK wrote is read, what is broken is refused with the place and the cure, what is written is
//! read back to the bit.
//!
//! `tests/data/meshes/` holds one mesh, a block with a hole (85 nodes, 225 tetrahedra): gmsh_*.msh as Gmsh 4.15.2 wrote it, vtk_*.vtu
//! as VTK 9.7.2 did, with a few triangles among the tetrahedra.

use std::f64::consts::TAU;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use cutwater::geometry::{Surface, TetFile, TetMesh, fill, parse_tets, read_tets};
use cutwater::output::write_mesh;
use cutwater::scene::{Placement, Solid, SolidMesh};
use glam::{DMat3, DVec3};

use crate::common::Random;
use crate::output::{f32s, flat, python};
use crate::solid_scene::body;
use crate::tet_mesh::{assert_sound, euler_characteristic};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/meshes").join(name)
}

/// A file of this name with these contents; the error as text.
fn read(name: &str, contents: &[u8]) -> Result<TetFile, String> {
    parse_tets(contents, Path::new(name)).map_err(|error| {
        assert_eq!(error.exit_code(), 2, "{error}");
        error.to_string()
    })
}

// What other programs wrote

#[test]
fn meshes_of_gmsh_are_read() {
    let text = read_tets(&data("gmsh_text.msh")).unwrap();
    assert_eq!((text.mesh.nodes.len(), text.mesh.elements.len()), (85, 225));
    assert_sound(&text.mesh, "gmsh_text.msh");
    // Summed by numpy from the file as meshio reads it.
    assert!((text.mesh.volume() - 1.855298357422565).abs() < 1e-14);
    assert_eq!(text.notes, ["218 elements of fewer dimensions ignored"]);
    // Lines, points and triangles come first.
    assert_eq!((text.numbers[0], text.numbers[224]), (219, 443));
    let binary = read_tets(&data("gmsh_binary.msh")).unwrap();
    assert_eq!(binary.mesh.elements, text.mesh.elements);
    assert_eq!(binary.numbers, text.numbers);
    // Gmsh writes 16 digits.
    for (x, y) in binary.mesh.nodes.iter().zip(&text.mesh.nodes) {
        assert!(x.distance(*y) < 1e-14, "{x}, {y}");
    }
    let parametric = read_tets(&data("gmsh_parametric.msh")).unwrap();
    assert_eq!(parametric.mesh, text.mesh);
    let two = tets(&CORNERS, &[&[0, 1, 2, 3], &[1, 2, 3, 4]]);
    let two = read("two.msh", two.as_bytes()).unwrap();
    for (big_endian, wide) in [(false, false), (false, true), (true, false), (true, true)] {
        let binary = read("two.msh", &binary_msh(big_endian, wide)).unwrap();
        assert_eq!(binary.mesh, two.mesh, "{big_endian} {wide}");
        assert_eq!(binary.numbers, [101, 102]);
        assert_eq!(binary.notes, ["1 elements of fewer dimensions ignored"]);
    }
}

#[test]
fn meshes_of_vtk_are_read_in_all_encodings() {
    let gmsh = read_tets(&data("gmsh_text.msh")).unwrap().mesh;
    for name in ["ascii", "binary", "binary_zlib", "raw", "raw_zlib", "base64", "base64_zlib", "big"] {
        let read = read_tets(&data(&format!("vtk_{name}.vtu"))).unwrap();
        assert_eq!(read.mesh.elements, gmsh.elements, "{name}");
        for (x, y) in read.mesh.nodes.iter().zip(&gmsh.nodes) {
            // Text has fewer digits.
            let digits = if name == "ascii" { 1e-10 } else { 0.0 };
            assert!(x.distance(*y) <= digits, "{name}: {x}, {y}");
        }
        assert_eq!(read.notes, ["7 cells of fewer dimensions ignored"], "{name}");
        // A triangle after each of the first tetrahedra.
        assert_eq!(&read.numbers[..3], [0, 2, 4], "{name}");
    }
    let lz4 = read_tets(&data("vtk_lz4.vtu")).unwrap_err().to_string();
    assert!(lz4.contains("vtkLZ4DataCompressor"), "{lz4}");
    assert!(lz4.contains("ZLib"), "{lz4}");
}

// What is written

#[test]
fn written_meshes_are_read_back_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mesh.vtu");
    let bricks = |cells: [usize; 3], size: DVec3| TetMesh::new(&body(SolidMesh::Box { size, cells }), "test").unwrap();
    // The third has 3072 elements: its arrays are whole multiples of 4 KiB.
    for cells in [[1, 1, 1], [3, 5, 2], [8, 8, 8]] {
        let mesh = bricks(cells, DVec3::new(0.1, 1.0 / 3.0, 7e-5));
        write_mesh(&file, &mesh).unwrap();
        let head = fs::read_to_string(&file).unwrap()[..300].to_owned();
        assert!(head.contains("ZLib"), "{head}");
        let read = read_tets(&file).unwrap();
        assert_eq!(read.mesh, mesh, "{cells:?}");
        assert!(read.notes.is_empty(), "{:?}", read.notes);
        // Another reader finds the same.
        let Some(python) = python() else { continue };
        let found = crate::output::read(&python, &file);
        assert_eq!(found["dtype"], "float64");
        let points = mesh.nodes.iter().flat_map(|x| x.to_array());
        assert_eq!(flat(&found["coordinates"]), f32s(points));
        let corners = &found["connectivity"]["TETRA"];
        assert_eq!(*corners, serde_json::json!(mesh.elements));
        let ratios = mesh.elements.iter().map(|&e| mesh.shape(e).mean_ratio);
        assert_eq!(flat(&found["cells"]["mean_ratio"]["values"]), f32s(ratios));
    }
}

// What is broken

const CORNERS: [[f64; 3]; 5] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]];

/// A text file of Gmsh 4.1 with nodes 11, 12 and so on and elements 101 and so on.
fn msh(nodes: &[[f64; 3]], kind: usize, elements: &[&[usize]]) -> String {
    let (n, m) = (nodes.len(), elements.len());
    let tags: String = (0..n).map(|node| format!("{}\n", 11 + node)).collect();
    let places: String = nodes.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    let elements = elements.iter().enumerate().map(|(number, corners)| {
        let corners: Vec<_> = corners.iter().map(|corner| (11 + corner).to_string()).collect();
        format!("{} {}\n", 101 + number, corners.join(" "))
    });
    let elements: String = elements.collect();
    format!(
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 {n} 11 {}\n3 1 0 {n}\n{tags}{places}$EndNodes\n$Elements\n1 {m} 101 {}\n\
         3 1 {kind} {m}\n{elements}$EndElements\n",
        10 + n,
        100 + m
    )
}

/// Tetrahedra of a text file of Gmsh.
fn tets(nodes: &[[f64; 3]], elements: &[&[usize]]) -> String {
    msh(nodes, 4, elements)
}

/// The same two tetrahedra as `tets(&CORNERS, ..)` in a binary file of Gmsh, with a triangle before them.
fn binary_msh(big_endian: bool, wide: bool) -> Vec<u8> {
    let int = |value: u32| match big_endian {
        true => value.to_be_bytes().to_vec(),
        false => value.to_le_bytes().to_vec(),
    };
    let size = |value: u32| match (wide, big_endian) {
        (false, _) => int(value),
        (true, true) => u64::from(value).to_be_bytes().to_vec(),
        (true, false) => u64::from(value).to_le_bytes().to_vec(),
    };
    let double = |value: f64| match big_endian {
        true => value.to_be_bytes().to_vec(),
        false => value.to_le_bytes().to_vec(),
    };
    let sizes = |values: &[u32]| values.iter().flat_map(|&v| size(v)).collect::<Vec<u8>>();
    let ints = |values: &[u32]| values.iter().flat_map(|&v| int(v)).collect::<Vec<u8>>();
    let places = CORNERS.iter().flatten().flat_map(|&x| double(x));
    [
        format!("$MeshFormat\n4.1 1 {}\n", if wide { 8 } else { 4 }).into_bytes(),
        int(1),
        b"\n$EndMeshFormat\n$Nodes\n".to_vec(),
        sizes(&[1, 5, 11, 15]),
        ints(&[3, 1, 0]),
        sizes(&[5, 11, 12, 13, 14, 15]),
        places.collect(),
        b"\n$EndNodes\n$Elements\n".to_vec(),
        sizes(&[2, 3, 100, 102]),
        ints(&[2, 1, 2]),
        sizes(&[1, 100, 11, 12, 13]),
        ints(&[3, 1, 4]),
        sizes(&[2, 101, 11, 12, 13, 14, 102, 12, 13, 14, 15]),
        b"\n$EndElements\n".to_vec(),
    ]
    .concat()
}

/// A text file of VTK; `values` are those of connectivity, offsets and types.
fn vtu(points: &[[f64; 3]], values: [&str; 3]) -> String {
    let n_cells = values[2].split_whitespace().count();
    let places: String = points.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    let [connectivity, offsets, types] = values;
    let array = |kind: &str, name: &str, values: &str| {
        format!("<DataArray type=\"{kind}\" Name=\"{name}\" format=\"ascii\">\n{values}\n</DataArray>\n")
    };
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order=\"LittleEndian\">\n\
         <UnstructuredGrid>\n<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{n_cells}\">\n<Points>\n{}</Points>\n\
         <Cells>\n{}{}{}</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n",
        points.len(),
        array("Float64", "Points", &places),
        array("Int64", "connectivity", connectivity),
        array("Int64", "offsets", offsets),
        array("UInt8", "types", types),
    )
}

#[test]
fn what_is_no_mesh_of_a_solid_is_refused_with_the_place_and_the_cure() {
    let two: &[&[usize]] = &[&[0, 1, 2, 3], &[1, 2, 3, 4]];
    let mut nan = CORNERS;
    nan[2][1] = f64::NAN;
    let mut flat = CORNERS;
    flat[4] = [1.0 / 3.0; 3];
    let mut double = CORNERS.to_vec();
    double.extend(CORNERS);
    double[8] = [2.0; 3];
    let mut older = tets(&CORNERS, two);
    older = older.replace("4.1 0 8", "2.2 0 8");
    let cases: &[(&str, String, &[&str])] = &[
        ("old.msh", older, &["old.msh:2", "MSH format 2.2", "gmsh", "old.msh -save -format msh41 -o", "old_41.msh"]),
        ("f.msh", "(0 \"fluent\")".into(), &["not a Gmsh file", "cure: "]),
        ("f.msh", String::new(), &["not a Gmsh file"]),
        ("f.msh", tets(&nan, two), &["node 13 is at", "finite"]),
        ("f.msh", tets(&flat, two), &["element 102", "no volume", "cure: "]),
        ("f.msh", tets(&CORNERS, &[&[0, 1, 2, 3], &[1, 3, 2, 4]]), &["element 102 is inverted", "orientation"]),
        ("f.msh", tets(&CORNERS, &[&[0, 1, 2, 3], &[1, 2, 2, 4]]), &["element 102 has node 13 twice"]),
        ("f.msh", tets(&CORNERS, &[&[0, 1, 2, 3], &[0, 1, 2, 3]]), &["element 101, element 102 overlap"]),
        ("f.msh", tets(&CORNERS, &[&[0, 1, 2, 3], &[0, 1, 2, 4]]), &["element 101, element 102 overlap"]),
        (
            "f.msh",
            tets(&CORNERS, &[&[0, 1, 2, 3], &[1, 2, 3, 4], &[1, 2, 3, 4]]),
            &["element 101, element 102, element 103 share one face"],
        ),
        ("f.msh", tets(&double, &[&[0, 1, 2, 3], &[6, 7, 9, 8]]), &["node 12 and node 17", "both at", "merge"]),
        ("f.msh", tets(&CORNERS, &[&[0, 1, 2, 9]]), &["f.msh:21", "element 101 has node 20", "$Nodes"]),
        ("f.msh", tets(&CORNERS, &[]), &["no tetrahedra"]),
        ("f.msh", msh(&CORNERS, 2, &[&[0, 1, 2]]), &["no tetrahedra"]),
        (
            "f.msh",
            msh(&CORNERS, 11, &[&[0, 1, 2, 3, 0, 1, 2, 3, 0, 1]]),
            &["element 101 is a tetrahedron of higher order", "SetOrder 1"],
        ),
        ("f.msh", msh(&CORNERS, 6, &[&[0, 1, 2, 3, 4, 0]]), &["element 101 is a prism"]),
        ("f.msh", msh(&CORNERS, 77, &[&[0, 1]]), &["element 101 is of type 77"]),
        ("f.msh", tets(&CORNERS, two).replace("13\n", "12\n"), &["f.msh:9", "node 12 is there twice"]),
        (
            "f.msh",
            tets(&CORNERS, two).replace("0 0 1\n", "0 zero 1\n"),
            &["f.msh:15", "\"zero\" where a number belongs"],
        ),
        ("f.msh", tets(&CORNERS, two).replace("$EndNodes\n", ""), &["$EndNodes belongs"]),
        ("f.msh", tets(&CORNERS, two).replace("$EndElements\n", ""), &["ends too early"]),
        (
            "f.msh",
            tets(&CORNERS, two).replace("3 1 4 2\n", "3 1 4 999999999999\n"),
            &["\"$EndElements\" where a whole number belongs"],
        ),
        ("f.msh", tets(&CORNERS, two).replace("4.1 0 8", "4.1 0 3"), &["sizes of 3 bytes"]),
        ("f.msh", tets(&CORNERS, two).replace("4.1 0 8", "4.1 2 8"), &["file type 2"]),
        ("f.vtu", vtu(&CORNERS, ["0 1 2 3 1 3 2 4", "4 8", "10 10"]), &["cell 1 is inverted"]),
        (
            "f.vtu",
            vtu(&CORNERS, ["0 1 2 3 1 2 3 5", "4 8", "10 10"]),
            &["f.vtu:16", "cell 1 has point 5, but there are 5"],
        ),
        ("f.vtu", vtu(&CORNERS, ["0 1 2 3 1 2 3 -1", "4 8", "10 10"]), &["cell 1 has point -1"]),
        ("f.vtu", vtu(&CORNERS, ["0 1 2 3", "4 8", "10 10"]), &["cell 1 ends at 8"]),
        ("f.vtu", vtu(&CORNERS, ["0 1 2 3", "-4", "10"]), &["cell 0 ends at -4"]),
        ("f.vtu", vtu(&CORNERS, ["0 1 2 3", "4", "10 10"]), &["1 values for 2 cells"]),
        ("f.vtu", vtu(&CORNERS, ["0 1 2 3 4", "5", "10"]), &["cell 0 is a tetrahedron with 5 points"]),
        ("f.vtu", vtu(&CORNERS, ["0 1 2 3 4", "5", "14"]), &["cell 0 is a pyramid", "Tetrahedralize"]),
        (
            "f.vtu",
            vtu(&CORNERS, ["0 1 2 3 0 1 2 3 0 1", "10", "24"]),
            &["cell 0 is a tetrahedron of higher order", "Linearize"],
        ),
        ("f.vtu", vtu(&CORNERS, ["0 1 2 3.5", "4", "10"]), &["f.vtu:16", "not a list of whole numbers"]),
        ("f.vtu", vtu(&CORNERS, ["0 1 2", "3", "5"]), &["no tetrahedra"]),
        ("f.vtu", vtu(&CORNERS, ["", "", ""]), &["no tetrahedra"]),
        ("f.vtu", vtu(&CORNERS, ["0 1 2 3", "4", "10"]).replace("Float64", "Float128"), &["f.vtu"]),
        ("f.vtu", vtu(&CORNERS, ["0 1 2 3", "4", "10"]).replace("connectivity", "corners"), &["no array connectivity"]),
        ("f.vtu", vtu(&CORNERS, ["0 1 2 3", "4", "10"]).replace("\"5\"", "\"6\""), &["15 coordinates of 6 points"]),
        (
            "f.vtu",
            vtu(&CORNERS, ["0 1 2 3", "4", "10"]).replace("UnstructuredGrid", "PolyData"),
            &["PolyData, not an UnstructuredGrid"],
        ),
        ("f.vtu", "<?xml version=\"1.0\"?>\n<VTKFile>".into(), &["not an XML file", "never closed"]),
        ("f.vtu", "# vtk DataFile Version 3.0\n".into(), &["not an XML file", ".vtk"]),
        ("f.obj", "v 0 0 0\n".into(), &["a surface, not tetrahedra", "cell_size"]),
        ("f.inp", "*NODE\n".into(), &["unknown kind of mesh file", ".vtu"]),
    ];
    for (name, contents, parts) in cases {
        let error = read(name, contents.as_bytes()).expect_err(&format!("{parts:?}"));
        for part in *parts {
            assert!(error.contains(part), "no {part:?} in {error:?} of\n{contents}");
        }
        assert!(error.contains("\n  cure: "), "{error}");
    }
    // The files that these are made from are sound.
    read("f.msh", tets(&CORNERS, two).as_bytes()).unwrap();
    read("f.vtu", vtu(&CORNERS, ["0 1 2 3 1 2 3 4", "4 8", "10 10"]).as_bytes()).unwrap();
}

#[test]
fn what_can_be_mended_is_mended_and_told() {
    // All inverted, nodes 15 and 16 unused, tags in disorder.
    let mut nodes = CORNERS.to_vec();
    nodes.push([5.0; 3]);
    let text = tets(&nodes, &[&[0, 2, 1, 3]]);
    let found = read("f.msh", text.as_bytes()).unwrap();
    assert_eq!(found.mesh.nodes, CORNERS[..4].iter().map(|&x| DVec3::from_array(x)).collect::<Vec<_>>());
    assert_sound(&found.mesh, "turned");
    assert_eq!(found.notes, ["2 nodes dropped, which no tetrahedron uses", "1 tetrahedra turned: all were inverted"]);
    // Numbers of nodes mean what the file says, not their order.
    let swapped = tets(&CORNERS[..4], &[&[0, 1, 2, 3]]).replace("11\n12\n13\n14\n", "12\n11\n13\n14\n");
    let swapped = read("f.msh", swapped.as_bytes()).unwrap();
    assert_eq!(swapped.mesh.elements, [[1, 0, 3, 2]]);
    assert_eq!(swapped.notes, ["1 tetrahedra turned: all were inverted"]);
}

/// Small files of all kinds that are sound.
fn small_files() -> Vec<(&'static str, Vec<u8>)> {
    let folder = tempfile::tempdir().unwrap();
    let written = folder.path().join("written.vtu");
    let brick = SolidMesh::Box { size: DVec3::ONE, cells: [1, 1, 2] };
    write_mesh(&written, &TetMesh::new(&body(brick), "test").unwrap()).unwrap();
    let text = tets(&CORNERS, &[&[0, 1, 2, 3], &[1, 2, 3, 4]]);
    let points = vtu(&CORNERS, ["0 1 2 3 1 2 3 4", "4 8", "10 10"]);
    vec![
        ("text.msh", text.into_bytes()),
        ("little.msh", binary_msh(false, true)),
        ("big.msh", binary_msh(true, false)),
        ("ascii.vtu", points.into_bytes()),
        ("written.vtu", fs::read(written).unwrap()),
        ("raw_zlib.vtu", fs::read(data("vtk_raw_zlib.vtu")).unwrap()),
    ]
}

#[test]
fn files_cut_off_anywhere_are_refused() {
    for (name, whole) in small_files() {
        let sound = read(name, &whole).unwrap();
        for length in 0..whole.len() {
            // Only what nothing depends on may be missing: line ends, the end marks of raw data.
            match read(name, &whole[..length]) {
                Ok(cut) => {
                    assert!(cut == sound && whole.len() - length < 32, "{name} cut at {length} of {}", whole.len())
                }
                Err(error) => assert!(error.starts_with(name), "{error}"),
            }
        }
    }
}

#[test]
fn damaged_bytes_and_huge_counts_neither_panic_nor_fill_the_memory() {
    let mut random = Random(7);
    for (name, whole) in small_files() {
        let sound_or_refused = |bytes: &[u8]| {
            if let Ok(file) = read(name, bytes) {
                assert_eq!(file.mesh.fault(), None, "{name}");
            }
        };
        // The largest count of four and of eight bytes, or of digits, in every place of a small file.
        for at in (0..whole.len() - 8).step_by(1 + whole.len() / 2000) {
            let mut changed = whole.clone();
            let count = if name == "text.msh" || name == "ascii.vtu" { b'9' } else { 0xff };
            changed[at..at + 4].fill(count);
            sound_or_refused(&changed);
            changed[at + 4..at + 8].fill(count);
            sound_or_refused(&changed);
        }
        for _ in 0..200 {
            let mut changed = whole.clone();
            for _ in 0..3 {
                let at = random.uniform(0.0, whole.len() as f64) as usize;
                changed[at] = random.bits() as u8;
            }
            sound_or_refused(&changed);
        }
    }
}

// Placement

#[test]
fn files_are_placed_about_the_middle_of_their_box() {
    let file = SolidMesh::File { file: data("gmsh_text.msh").into(), unit: 1.0 };
    let plain = TetMesh::new(&body(file.clone()), "test").unwrap();
    let [low, high] = plain.bounds();
    let middle = 0.5 * (low + high);
    let mut random = Random(3);
    for _ in 0..10 {
        let vector = |random: &mut Random| DVec3::from_array([0; 3].map(|_| random.uniform(-1.0, 1.0)));
        let placement = Placement {
            translate: vector(&mut random),
            rotate: DMat3::from_axis_angle(vector(&mut random).normalize(), random.uniform(-3.0, 3.0)),
            scale: random.uniform(0.1, 4.0),
            at: None,
        };
        let placed = Solid { placement, ..body(file.clone()) };
        let placed = TetMesh::new(&placed, "test").unwrap();
        assert_sound(&placed, "placed");
        assert_eq!(placed.elements, plain.elements);
        let ratio = placed.volume() / (placement.scale.powi(3) * plain.volume());
        assert!((ratio - 1.0).abs() < 1e-13, "{ratio}");
        for (x, rest) in placed.nodes.iter().zip(&plain.nodes) {
            let turned = placement.rotate * (*rest - middle) * placement.scale;
            assert!(x.distance(middle + turned + placement.translate) < 1e-14);
        }
    }
}

// Fills

/// A ring about y, its tube of `sides` sides.
fn torus(ring: f64, tube: f64, sides: usize) -> Surface {
    let mut surface = Surface::default();
    let n = 3 * sides;
    let number = |i: usize, j: usize| (i % n * sides + j % sides) as u32;
    for i in 0..n {
        for j in 0..sides {
            let [(sin, cos), (up, out)] = [(i, n), (j, sides)].map(|(at, of)| (TAU * at as f64 / of as f64).sin_cos());
            let radius = ring + tube * out;
            let x = DVec3::new(radius * cos, tube * up, radius * sin);
            surface.vertices.push(x);
            let [a, b, c, d] = [(0, 0), (0, 1), (1, 1), (1, 0)].map(|(k, l)| number(i + k, j + l));
            surface.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    surface
}

/// Distance from a point to the nearest triangle (Ericson, Real-Time Collision Detection, 5.1.5, by cases of the barycentric weights).
fn distance(surface: &Surface, x: DVec3) -> f64 {
    let to_edge = |a: DVec3, b: DVec3| {
        let along = ((x - a).dot(b - a) / a.distance_squared(b)).clamp(0.0, 1.0);
        x.distance(a + along * (b - a))
    };
    let triangles = (0..surface.triangles.len()).map(|number| surface.corners(number));
    let distances = triangles.map(|[a, b, c]| {
        let normal = (b - a).cross(c - a).normalize();
        let foot = x - normal * normal.dot(x - a);
        let inside = |from: DVec3, to: DVec3| (to - from).cross(foot - from).dot(normal) >= 0.0;
        if inside(a, b) && inside(b, c) && inside(c, a) {
            x.distance(foot)
        } else {
            to_edge(a, b).min(to_edge(b, c)).min(to_edge(c, a))
        }
    });
    distances.fold(f64::INFINITY, f64::min)
}

#[test]
fn fills_follow_their_surface_with_good_elements() {
    let turn = DMat3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.5);
    let bricks = |half: DVec3| Surface::cuboid(-half, half);
    // Surface, edge length, largest share of the volume that may be missing, Euler characteristic. The last plate is one of which
    // parry alone keeps but a skin.
    let cases = [
        ("cube", bricks(DVec3::splat(0.5)), 0.2, 0.01, 2),
        ("finer cube", bricks(DVec3::splat(0.5)), 0.1, 0.002, 2),
        ("turned plate", bricks(DVec3::new(0.5, 0.1, 0.4)).map(|x| turn * x), 0.1, 0.03, 2),
        ("torus", torus(1.0, 0.4, 16), 0.25, 0.05, 0),
        ("plate", bricks(DVec3::new(1.0, 0.2, 1.0)), 0.125, 0.01, 2),
    ];
    for (name, surface, cell_size, missing, euler) in cases {
        assert_eq!(surface.fault(), None, "{name}");
        let mesh = fill(&surface, cell_size).unwrap();
        assert_sound(&mesh, name);
        assert_eq!(mesh.components(), 1, "{name}");
        assert_eq!(euler_characteristic(&mesh.surface()), euler, "{name}");
        let ratio = mesh.volume() / surface.volume();
        assert!(ratio > 1.0 - missing && ratio < 1.002, "{name}: {ratio}");
        let shape = mesh.worst_element().unwrap().1;
        assert!(shape.mean_ratio > 0.29 && shape.min_dihedral > 7.0, "{name}: {shape:?}");
        let outer = mesh.surface();
        let off = outer.iter().flatten().map(|&node| distance(&surface, mesh.nodes[node as usize]));
        let farthest = off.fold(0.0, f64::max);
        assert!(farthest < 0.2 * cell_size, "{name}: {farthest} m");
    }
}

#[test]
fn surfaces_become_solids_of_a_scene() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cube.obj");
    let cube = Surface::cuboid(DVec3::splat(1.0), DVec3::splat(2.0));
    let vertices = cube.vertices.iter().map(|v| format!("v {} {} {}\n", v.x, v.y, v.z));
    let faces = cube.triangles.iter().map(|t| {
        let [a, b, c] = t.map(|v| v + 1);
        format!("f {a} {b} {c}\n")
    });
    fs::write(&file, vertices.chain(faces).collect::<String>()).unwrap();
    let surface = |cell_size: f64| {
        let mesh = SolidMesh::Surface { file: file.clone().into(), unit: 1.0, cell_size };
        let placement = Placement {
            translate: DVec3::new(0.0, 5.0, 0.0),
            rotate: DMat3::from_rotation_y(0.3),
            scale: 2.0,
            at: None,
        };
        TetMesh::new(&Solid { placement, ..body(mesh) }, "scene.toml: solid[0]")
    };
    let mesh = surface(0.25).unwrap();
    assert_sound(&mesh, "cube.obj");
    let [low, high] = mesh.bounds();
    let middle = 0.5 * (low + high);
    assert!((middle - DVec3::new(1.5, 6.5, 1.5)).length() < 0.05, "{middle}");
    assert!((mesh.volume() / 8.0 - 1.0).abs() < 0.01, "{}", mesh.volume());
    for (cell_size, part) in [
        (0.0, "cell_size is 0 m"),
        (-1.0, "at most the longest extent"),
        (f64::NAN, "cell_size is NaN m"),
        (1.5, "cell_size is 1.5 m"),
        (1e-4, "give a larger cell_size"),
    ] {
        let error = surface(cell_size).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let error = error.to_string();
        assert!(error.starts_with("scene.toml: solid[0]"), "{error}");
        assert!(error.contains(part), "no {part} in {error}");
    }
}

#[test]
fn shapes_that_cannot_be_are_refused() {
    let cuboid = |size: [f64; 3], cells| SolidMesh::Box { size: DVec3::from_array(size), cells };
    let ball = |radius, cell_size| SolidMesh::Sphere { radius, cell_size };
    let shell = |radius, thickness, cell_size| SolidMesh::Shell { radius, thickness, cell_size };
    for (mesh, part) in [
        (cuboid([1.0, 0.0, 1.0], [1; 3]), "all positive"),
        (cuboid([1.0, f64::NAN, 1.0], [1; 3]), "all positive"),
        (cuboid([1.0; 3], [1, 0, 1]), "all positive"),
        (cuboid([1.0; 3], [1000; 3]), "6000000000 elements"),
        (cuboid([1.0, 1.0, 1e-14], [1; 3]), "has no volume"),
        (ball(1.0, 2.0), "at most the radius"),
        (ball(1.0, 0.0), "a positive cell_size"),
        (ball(f64::NAN, 0.1), "radius NaN m"),
        (ball(1.0, 1e-9), "give a larger cell_size"),
        (shell(1.0, 1.0, 0.1), "a thickness between 0 and the radius"),
        (shell(1.0, 0.0, 0.1), "a thickness between 0 and the radius"),
        (shell(1.0, 0.1, f64::NAN), "a positive cell_size"),
    ] {
        let error = TetMesh::new(&body(mesh.clone()), "scene.toml: solid[1]").unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let error = error.to_string();
        assert!(error.starts_with("scene.toml: solid[1]: "), "{error}");
        assert!(error.contains(part), "{mesh:?}: no {part} in {error}");
    }
}

// The command

#[test]
fn the_mesh_command_tells_and_writes() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_cutwater"))
            .arg("mesh")
            .args(arguments)
            .current_dir(folder.path())
            .output()
            .unwrap();
        let text = [output.stdout, output.stderr].concat();
        (output.status.code(), String::from_utf8(text).unwrap())
    };
    let gmsh = data("gmsh_text.msh");
    let gmsh = gmsh.to_str().unwrap();
    let (code, said) = run(&[gmsh, "--out", "block.vtu"]);
    assert_eq!(code, Some(0), "{said}");
    let worst = read_tets(&data("gmsh_text.msh")).unwrap();
    let number = worst.numbers[worst.mesh.worst_element().unwrap().0];
    for part in [
        "note: 218 elements of fewer dimensions ignored",
        "85 nodes, 225 tetrahedra, 1 part",
        "volume 1.855298e0 m^3",
        "from [0, 0, 0] to [2, 1, 1] m",
        &format!("worst: element {number}, mean ratio 0."),
        "written: block.vtu",
    ] {
        assert!(said.contains(part), "no {part} in {said}");
    }
    let written = read_tets(&folder.path().join("block.vtu")).unwrap();
    assert_eq!(written.mesh, worst.mesh);

    let faces = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    fs::write(folder.path().join("tet.obj"), faces).unwrap();
    let (code, said) = run(&["tet.obj", "--cell-size", "0.2"]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("volume of the surface 1.666667e-1 m^3: the mesh differs by "), "{said}");
    for (arguments, part) in [
        (&["tet.obj"][..], "--cell-size"),
        (&["tet.obj", "--cell-size", "-1"], "cell_size is -1 m"),
        (&["block.vtu", "--cell-size", "1"], "only surfaces"),
        (&["block.vtu", "--out", "block.obj"], "ends in .vtu"),
        (&["no.msh"], "readable mesh file"),
    ] {
        let (code, said) = run(arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {said}");
        assert!(said.contains(part) && said.contains("cure: "), "{said}");
    }
}
