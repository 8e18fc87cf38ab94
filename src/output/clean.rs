//! Closed triangle meshes without coincident vertices and without triangles of no area.
//!
//! Pressing a surface flat against the walls folds what lies beyond them: vertices fall onto each other along the edges of the domain, and
//! triangles onto lines. Readers that merge vertices would find holes there.

use std::collections::{BTreeMap, HashMap};

use glam::Vec3;

/// Places per unit of length: 2^13. Coordinates up to 1024 are exact on this lattice in f32, and so are differences.
const PLACES: f32 = 8192.0;
/// Passes of edge flips; each leaves fewer flat triangles, or ends the work.
const PASSES: usize = 8;

/// Moves vertices to the nearest of 2^13 places per unit, merges those in one place, removes triangles without area and what is left over.
/// Every edge keeps as many triangles on one side as on the other.
pub(super) fn clean(vertices: &mut Vec<Vec3>, triangles: &mut Vec<[u32; 3]>) {
    merge(vertices, triangles);
    for _ in 0..PASSES {
        cancel(triangles);
        if !flip_flat(vertices, triangles) {
            break;
        }
    }
    compact(vertices, triangles);
}

/// Merges vertices in the same place; triangles with two corners in one place are gone.
fn merge(vertices: &mut [Vec3], triangles: &mut Vec<[u32; 3]>) {
    let mut first = HashMap::with_capacity(vertices.len());
    let mut merged = Vec::with_capacity(vertices.len());
    for (number, vertex) in vertices.iter_mut().enumerate() {
        let place = (*vertex * PLACES).round();
        *vertex = place / PLACES;
        let place = place.to_array().map(|x| x as i32);
        merged.push(*first.entry(place).or_insert(number as u32));
    }
    for corners in triangles.iter_mut() {
        *corners = corners.map(|corner| merged[corner as usize]);
    }
    triangles.retain(|&[a, b, c]| a != b && b != c && c != a);
}

/// Removes pairs of triangles that are each other's back.
fn cancel(triangles: &mut Vec<[u32; 3]>) {
    // How many more have the order of the first two corners that is even.
    let mut sums: HashMap<[u32; 3], i32> = HashMap::with_capacity(triangles.len());
    let key = |corners: &[u32; 3]| {
        let mut sorted = *corners;
        sorted.sort_unstable();
        let turned = [[0, 1, 2], [1, 2, 0], [2, 0, 1]];
        let even = turned.iter().any(|turn| turn.map(|n| corners[n]) == sorted);
        (sorted, if even { 1 } else { -1 })
    };
    for corners in triangles.iter() {
        let (sorted, sign) = key(corners);
        *sums.entry(sorted).or_default() += sign;
    }
    triangles.retain(|corners| {
        let (sorted, sign) = key(corners);
        let left = sums.get_mut(&sorted);
        left.is_some_and(|left| {
            let keep = *left * sign > 0;
            *left -= if keep { sign } else { 0 };
            keep
        })
    });
}

/// Whether three places, which are exact, lie on a line.
fn is_flat(corners: [u32; 3], vertices: &[Vec3]) -> bool {
    let [a, b, c] = corners.map(|corner| vertices[corner as usize].as_dvec3());
    (b - a).cross(c - a) == glam::DVec3::ZERO
}

/// A triangle of three corners on a line has its longest edge in common with another one: flips that edge. Whether something changed.
fn flip_flat(vertices: &[Vec3], triangles: &mut [[u32; 3]]) -> bool {
    let flat: Vec<usize> = (0..triangles.len())
        .filter(|&at| is_flat(triangles[at], vertices))
        .collect();
    if flat.is_empty() {
        return false;
    }
    // Directed edges with their triangle; in order, so that the same mesh has the same flips.
    let mut owners: BTreeMap<[u32; 2], Vec<usize>> = BTreeMap::new();
    for (at, [a, b, c]) in triangles.iter().enumerate() {
        for edge in [[a, b], [b, c], [c, a]] {
            owners
                .entry(edge.map(|corner| *corner))
                .or_default()
                .push(at);
        }
    }
    let mut touched = vec![false; triangles.len()];
    let mut changed = false;
    for at in flat {
        let place = |corner: u32| vertices[corner as usize];
        let corners = triangles[at];
        let turns = [0, 1, 2].map(|n| [corners[n], corners[(n + 1) % 3], corners[(n + 2) % 3]]);
        let length = |turn: &[u32; 3]| place(turn[0]).distance_squared(place(turn[2]));
        let Some([a, b, c]) = turns
            .into_iter()
            .max_by(|x, y| length(x).total_cmp(&length(y)))
        else {
            continue;
        };
        // The other side of the edge c a has it as a c.
        let beside = owners.get(&[a, c]).into_iter().flatten();
        let beside = beside
            .copied()
            .find(|&other| other != at && !touched[other]);
        let Some(other) = beside.filter(|_| !touched[at]) else {
            continue;
        };
        let Some(&d) = triangles[other]
            .iter()
            .find(|corner| **corner != a && **corner != c)
        else {
            continue;
        };
        if d == b {
            continue;
        }
        (triangles[at], triangles[other]) = ([a, b, d], [b, c, d]);
        (touched[at], touched[other]) = (true, true);
        changed = true;
    }
    changed
}

/// Removes vertices that no triangle has, keeping the order of the others.
fn compact(vertices: &mut Vec<Vec3>, triangles: &mut [[u32; 3]]) {
    let mut numbers = vec![None; vertices.len()];
    for corner in triangles.as_flattened() {
        numbers[*corner as usize] = Some(0);
    }
    let mut count = 0;
    for number in numbers.iter_mut().flatten() {
        *number = count;
        count += 1;
    }
    let mut number = numbers.iter();
    vertices.retain(|_| number.next().is_some_and(Option::is_some));
    for corner in triangles.as_flattened_mut() {
        *corner = numbers[*corner as usize].unwrap_or_default();
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use glam::Vec3;

    use super::{clean, is_flat};

    /// How often each directed edge is there, less its opposite.
    fn is_closed(triangles: &[[u32; 3]]) -> bool {
        let mut sums: BTreeMap<[u32; 2], i32> = BTreeMap::new();
        for &[a, b, c] in triangles {
            for [from, to] in [[a, b], [b, c], [c, a]] {
                let sign = if from < to { 1 } else { -1 };
                *sums.entry([from.min(to), from.max(to)]).or_default() += sign;
            }
        }
        sums.values().all(|&sum| sum == 0)
    }

    /// A tetrahedron one of whose edges carries a vertex in the middle, with a flat triangle over it; twice the vertex at the top.
    #[test]
    fn flat_triangles_and_double_vertices_go_and_the_mesh_stays_closed() {
        let at = |x, y, z| Vec3::new(x, y, z);
        let (o, x, y, top, middle) = (0, 1, 2, 3, 4);
        let mut vertices = vec![
            at(0.0, 0.0, 0.0),
            at(1.0, 0.0, 0.0),
            at(0.0, 1.0, 0.0),
            at(0.0, 0.0, 1.0),
            at(0.5, 0.0, 0.0),
            at(0.0, 1e-6, 1.0),
        ];
        let mut triangles = vec![
            // Below, with the whole edge o x; above it the flat one with both halves; then the side with the halves.
            [o, y, x],
            [o, x, middle],
            [o, middle, top],
            [middle, x, top],
            [x, y, 5],
            [o, top, y],
            // Between the two tops.
            [top, x, 5],
            [top, 5, y],
        ];
        assert!(is_closed(&triangles) && is_flat([o, x, middle], &vertices));
        let volume = |vertices: &[Vec3], triangles: &[[u32; 3]]| -> f32 {
            let of = |[a, b, c]: [Vec3; 3]| a.dot(b.cross(c)) / 6.0;
            let places = |corners: &[u32; 3]| corners.map(|corner| vertices[corner as usize]);
            triangles.iter().map(|corners| of(places(corners))).sum()
        };
        let before = volume(&vertices, &triangles);
        clean(&mut vertices, &mut triangles);
        assert_eq!(vertices.len(), 5);
        assert_eq!(triangles.len(), 6);
        assert!(is_closed(&triangles));
        assert!(
            triangles
                .iter()
                .all(|&corners| !is_flat(corners, &vertices)),
            "{triangles:?}"
        );
        assert!((volume(&vertices, &triangles) - before).abs() < 1e-5);
    }

    #[test]
    fn a_sheet_that_is_folded_onto_itself_is_nothing() {
        let mut vertices = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        let mut triangles = vec![[0, 1, 2], [1, 0, 2]];
        clean(&mut vertices, &mut triangles);
        assert!(vertices.is_empty() && triangles.is_empty());
    }
}
