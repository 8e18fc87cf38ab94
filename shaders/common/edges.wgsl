#import level
#import real

// Which cells of a quad are joined to their minus neighbours. The including file declares matrix (array<Real4>, see level).
struct Edges {
    x: vec4<bool>,
    y: vec4<bool>,
    z: vec4<bool>,
}

fn positive(section: u32, q: u32) -> vec4<bool> {
    return matrix[section * level.shape.total + q] > Real4();
}

fn edges_of(q: u32) -> Edges {
    return Edges(positive(0u, q), positive(1u, q), positive(2u, q));
}
