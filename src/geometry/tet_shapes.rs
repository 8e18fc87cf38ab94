//! Tetrahedral meshes of boxes, balls and shells, centred at the origin.

use glam::DVec3;

use super::icosahedron::{self, EDGE, Lattice};
use super::surface::Fault;
use super::tet_mesh::{MAX_ELEMENTS, TetMesh};

/// Nodes and elements are counted in u32.
fn check_count(elements: f64, cure: &'static str) -> Result<(), Fault> {
    if elements <= MAX_ELEMENTS {
        return Ok(());
    }
    let problem = format!("{elements:.0} elements, allowed are {MAX_ELEMENTS:.0}");
    Err(Fault { problem, cure })
}

/// A box of bricks, each cut into six tetrahedra around its diagonal from the low to the high corner (Kuhn 1960). Neighbours
/// share face diagonals. Nodes and bricks are numbered with z fastest.
pub(super) fn cuboid(size: DVec3, cells: [usize; 3]) -> Result<TetMesh, Fault> {
    if !(size.is_finite() && size.min_element() > 0.0 && cells.iter().all(|&n| n > 0)) {
        return Err(Fault {
            problem: format!("a box of {size} m with {cells:?} bricks"),
            cure: "three extents and three numbers of bricks, all positive",
        });
    }
    check_count(6.0 * cells.iter().map(|&n| n as f64).product::<f64>(), "give fewer cells")?;
    let [nx, ny, nz] = cells;
    let mut mesh = TetMesh::default();
    for i in 0..=nx {
        for j in 0..=ny {
            for k in 0..=nz {
                // Bitwise symmetric about the origin.
                let share = |at: usize, n: usize| (2.0 * at as f64 - n as f64) / (2.0 * n as f64);
                let shares = DVec3::new(share(i, nx), share(j, ny), share(k, nz));
                mesh.nodes.push(shares * size);
            }
        }
    }
    let step = [(ny + 1) * (nz + 1), nz + 1, 1].map(|step| step as u32);
    // Even permutations of the axes have a positive volume; odd ones need their middle corners exchanged.
    const ORDERS: [([usize; 3], bool); 6] = [
        ([0, 1, 2], true),
        ([1, 2, 0], true),
        ([2, 0, 1], true),
        ([0, 2, 1], false),
        ([1, 0, 2], false),
        ([2, 1, 0], false),
    ];
    for i in 0..nx as u32 {
        for j in 0..ny as u32 {
            for k in 0..nz as u32 {
                let low = i * step[0] + j * step[1] + k * step[2];
                for (order, even) in ORDERS {
                    let [a, b, c] = order.map(|axis| step[axis]);
                    let (first, second) = (low + a, low + a + b);
                    let high = low + a + b + c;
                    mesh.elements.push(if even { [low, first, second, high] } else { [low, second, first, high] });
                }
            }
        }
    }
    Ok(mesh)
}

/// A ball of exact volume, so surface nodes lie slightly outside the sphere: twenty tetrahedra between the centre and the faces
/// of an icosahedron, each cut like [`lattice`]. Edges are about `cell_size` long everywhere.
pub(super) fn ball(radius: f64, cell_size: f64) -> Result<TetMesh, Fault> {
    let n = segments(radius, cell_size)?;
    let unit = radius * icosahedron::equal_volume(&icosahedron::unit_sphere(n)) / n as f64;
    Ok(lattice([0, n], |layer| unit * layer as f64))
}

/// A shell with exact outer and inner volume. Its layers are planes of [`lattice`], or below a thickness of 0.415 cell sizes
/// one layer of prisms of three tetrahedra each.
pub(super) fn shell(radius: f64, thickness: f64, cell_size: f64) -> Result<TetMesh, Fault> {
    if !(thickness > 0.0 && thickness < radius) {
        return Err(Fault {
            problem: format!("a shell {thickness} m thick with the outer radius {radius} m"),
            cure: "a thickness between 0 and the radius",
        });
    }
    let n = segments(radius, cell_size)?;
    let layers = ((EDGE * thickness / cell_size).round() as usize).min(n - 1);
    let vertex_radius = |n: usize, radius: f64| radius * icosahedron::equal_volume(&icosahedron::unit_sphere(n));
    let (inner, outer) = (vertex_radius(n - layers, radius - thickness), vertex_radius(n, radius));
    if layers == 0 {
        return Ok(prisms(n, inner, outer));
    }
    Ok(lattice([n - layers, n], |layer| {
        let share = (layer + layers - n) as f64 / layers as f64;
        inner + share * (outer - inner)
    }))
}

/// Segments along an edge of the icosahedron on the outer surface.
fn segments(radius: f64, cell_size: f64) -> Result<usize, Fault> {
    if !(radius.is_finite() && radius > 0.0 && cell_size > 0.0 && cell_size <= radius) {
        return Err(Fault {
            problem: format!("cell_size is {cell_size} m, the radius {radius} m"),
            cure: "a positive cell_size, at most the radius",
        });
    }
    let n = (EDGE * radius / cell_size).round();
    check_count(20.0 * n * n * n, "give a larger cell_size")?;
    Ok(n as usize)
}

/// Cells between planes `first` and `last` of the icosahedron's [`Lattice`], projected to spheres: tetrahedra, and octahedra
/// cut into four along the diagonal with the best worst element. `radius` is that of a layer's nodes, m.
fn lattice([first, last]: [usize; 2], radius: impl Fn(usize) -> f64) -> TetMesh {
    let mut lattice = Lattice::new();
    let mut blocks = Vec::new();
    for face in icosahedron::FACES {
        let mut number = |weights: [usize; 3]| lattice.number(face, weights);
        for a in 0..last {
            for b in 0..last - a {
                for c in 0..last - a - b {
                    // Corners of the skewed cube at (a, b, c) lie on planes a + b + c to a + b + c + 3.
                    let low = a + b + c;
                    let mut corner = |bits: usize| number([a + (bits & 1), b + (bits >> 1 & 1), c + (bits >> 2)]);
                    if low >= first {
                        blocks.push(Block::Tetrahedron([0, 1, 2, 4].map(&mut corner)));
                    }
                    if low + 1 >= first && low + 2 <= last {
                        blocks.push(Block::Octahedron([1, 2, 4, 6, 5, 3].map(&mut corner)));
                    }
                    if low + 2 >= first && low + 3 <= last {
                        blocks.push(Block::Tetrahedron([3, 5, 6, 7].map(&mut corner)));
                    }
                }
            }
        }
    }
    let points = lattice.points.iter().zip(&lattice.planes);
    let mut mesh = TetMesh {
        nodes: points.map(|(x, &plane)| x.normalize_or_zero() * radius(plane)).collect(),
        elements: Vec::new(),
    };
    for block in blocks {
        match block {
            Block::Tetrahedron(element) => mesh.push_oriented(element),
            Block::Octahedron(corners) => {
                let cuts = [0, 1, 2].map(|diagonal| cut_octahedron(corners, diagonal));
                let worst = |cut: &[[u32; 4]; 4]| {
                    let shapes = cut.iter().map(|&element| mesh.shape(element));
                    // Elements are oriented later.
                    shapes.map(|s| s.mean_ratio.abs()).fold(f64::INFINITY, f64::min)
                };
                // With a margin, so that rounding does not choose among symmetric diagonals.
                let mut best = 0;
                for next in [1, 2] {
                    if worst(&cuts[next]) > (1.0 + 1e-9) * worst(&cuts[best]) {
                        best = next;
                    }
                }
                for element in cuts[best] {
                    mesh.push_oriented(element);
                }
            }
        }
    }
    mesh
}

/// Cells of a plane lattice.
enum Block {
    Tetrahedron([u32; 4]),
    /// Opposite corners have indices three apart.
    Octahedron([u32; 6]),
}

/// The four tetrahedra around one of the three diagonals.
fn cut_octahedron(corners: [u32; 6], diagonal: usize) -> [[u32; 4]; 4] {
    let [low, high] = [corners[diagonal], corners[diagonal + 3]];
    let ring = [1, 2, 4, 5].map(|step| corners[(diagonal + step) % 6]);
    [0, 1, 2, 3].map(|at| [low, high, ring[at], ring[(at + 1) % 4]])
}

/// One layer of prisms between two spheres. Neighbours cut their common side from the inner node of the smaller number to the
/// outer node of the larger.
fn prisms(n: usize, inner: f64, outer: f64) -> TetMesh {
    let unit = icosahedron::unit_sphere(n);
    let above = unit.vertices.len() as u32;
    let directions = unit.vertices.iter();
    let mut mesh = TetMesh {
        nodes: [inner, outer].into_iter().flat_map(|radius| directions.clone().map(move |&x| radius * x)).collect(),
        elements: Vec::new(),
    };
    for mut corners in unit.triangles {
        corners.sort_unstable();
        let [a, b, c] = corners;
        mesh.push_oriented([a, b, c, c + above]);
        mesh.push_oriented([a, b, b + above, c + above]);
        mesh.push_oriented([a, a + above, b + above, c + above]);
    }
    mesh
}

impl TetMesh {
    /// Adds an element, reoriented if inverted.
    fn push_oriented(&mut self, [a, b, c, d]: [u32; 4]) {
        let inverted = self.determinant([a, b, c, d]) < 0.0;
        self.elements.push(if inverted { [a, b, d, c] } else { [a, b, c, d] });
    }
}
