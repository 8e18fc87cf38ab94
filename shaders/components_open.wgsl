// Stage closed_components: marks the root of every component with a free surface, and counts the roots that are left.
// level: level 0. list, args: active quads. matrix: see level. labels: in and out, see components. state: see components.
#import dispatch
#import edges
#import find

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> matrix: array<Real4>;
@group(0) @binding(4) var<storage, read_write> labels: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> state: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn components_open(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let q = list[ix];
    // All cells of a uniform quad hang below others and none is at the surface.
    if (q & UNIFORM) != 0u {
        return;
    }
    let edges = edges_of(q);
    let surface = positive(DIRICHLET, q);
    var marks = surface;
    if any(surface) {
        // A neighbour of the same component at the surface does it.
        let left = vec4<bool>(positive(DIRICHLET, q - 1u).w, surface.xyz);
        marks &= !((edges.x & left) | (edges.y & positive(DIRICHLET, q - level.shape.stride_y))
            | (edges.z & positive(DIRICHLET, q - level.shape.stride_z)));
    }
    var left_over = 0u;
    for (var l = 0u; l < 4u; l++) {
        let cell = 4u * q + l;
        if (atomicLoad(&labels[cell]) & ~OPEN) == cell {
            left_over++;
        }
        if marks[l] {
            let root = find(cell);
            if (atomicLoad(&labels[root]) & OPEN) == 0u && (atomicOr(&labels[root], OPEN) & OPEN) == 0u {
                left_over--;
            }
        }
    }
    if left_over != 0u {
        // Adds up to the closed components modulo 2^32, in any order.
        atomicAdd(&state[COUNTER], left_over);
    }
}
