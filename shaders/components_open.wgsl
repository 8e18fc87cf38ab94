// Stage closed_components: marks the root of every component with a free surface, and of every one with a face that is not
// all open, and counts the roots that are left of each.
// level: level 0. list, args: active quads. matrix: see level. flags: see active. labels: in and out, see components. state:
// see components.
#import active
#import dispatch
#import edges
#import find

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> matrix: array<Real4>;
@group(0) @binding(4) var<storage, read_write> flags: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> labels: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> state: array<atomic<u32>>;

fn held(q: u32) -> vec4<bool> {
    return (vec4<u32>(atomicLoad(&flags[q]) >> HELD) & vec4<u32>(1u, 2u, 4u, 8u)) != vec4<u32>();
}

// The given lanes, without those that have a neighbour of the same component among them, which does it.
fn first_of(lanes: vec4<bool>, x: bool, y: vec4<bool>, z: vec4<bool>, edges: Edges) -> vec4<bool> {
    let left = vec4<bool>(x, lanes.xyz);
    return lanes & !((edges.x & left) | (edges.y & y) | (edges.z & z));
}

@compute @workgroup_size(WG_SIZE)
fn components_open(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[level.args + 3u] {
        return;
    }
    let q = list[ix];
    // All cells of a uniform quad hang below others and none is at the surface or a wall.
    if (q & UNIFORM) != 0u {
        return;
    }
    let edges = edges_of(q);
    let up_y = q - level.shape.stride_y;
    let up_z = q - level.shape.stride_z;
    var at_surface = positive(DIRICHLET, q);
    if any(at_surface) {
        at_surface = first_of(at_surface, positive(DIRICHLET, q - 1u).w, positive(DIRICHLET, up_y), positive(DIRICHLET, up_z), edges);
    }
    var at_wall = held(q);
    if any(at_wall) {
        at_wall = first_of(at_wall, held(q - 1u).w, held(up_y), held(up_z), edges);
    }
    var left_over = 0u;
    var loose = 0u;
    for (var l = 0u; l < 4u; l++) {
        let cell = 4u * q + l;
        if (atomicLoad(&labels[cell]) & ~OPEN) == cell {
            left_over++;
            loose++;
        }
        if !(at_surface[l] || at_wall[l]) {
            continue;
        }
        let root = find(cell);
        if at_surface[l] && (atomicLoad(&labels[root]) & OPEN) == 0u && (atomicOr(&labels[root], OPEN) & OPEN) == 0u {
            left_over--;
        }
        let mark = 1u << (HELD_ROOT + root % 4u);
        if at_wall[l] && (atomicLoad(&flags[root / 4u]) & mark) == 0u && (atomicOr(&flags[root / 4u], mark) & mark) == 0u {
            loose--;
        }
    }
    if left_over != 0u {
        // Adds up to the closed components modulo 2^32, in any order.
        atomicAdd(&state[COUNTER], left_over);
    }
    if loose != 0u {
        atomicAdd(&state[LOOSE], loose);
    }
}
