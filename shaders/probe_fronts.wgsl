// probe, fronts: the largest and the smallest coordinate of the liquid along each axis over active cells, m. It is the
// surface between an active cell and air, or the far face of a cell at a wall or beside other liquid.
// One thread per active quad.
// level, step. args, list: active quads. flags: see active. liquid_distance: m. sides: bits of the requested fronts,
// the largest along x, y, z, then the smallest. values: bits of the three largest, then the complements of the bits of
// the three smallest, 0 without liquid.
#import dispatch
#import layout
#import lanes
#import step
#import ghost_fluid
#import active

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> list: array<u32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> values: array<atomic<u32>>;
@group(0) @binding(7) var<uniform> sides: vec4<u32>;

// Moves a front outwards from the distances of a quad of cells and those one cell further. side: as in sides.
fn raise(side: u32, cell: vec3<i32>, lanes: vec4<bool>, phi: vec4<f32>, next: vec4<f32>) {
    let lower = side >= 3u;
    let axis = select(side, side - 3u, lower);
    let last = select(i32(level.cells[axis]) - 1, 0, lower);
    // The bits of positive floats are ordered like the floats, their complements the other way round.
    var bits = 0u;
    for (var l = 0; l < 4; l++) {
        if lanes[l] {
            let index = cell[axis] + select(0, l, axis == 0u);
            let ends = index == last || next[l] < 0.0;
            let reach = select(ghost_theta(phi[l], next[l], 0.0), 0.5, ends);
            let front = bitcast<u32>((f32(index) + 0.5 + select(reach, -reach, lower)) * step.dx);
            bits = max(bits, select(front, ~front, lower));
        }
    }
    if bits > atomicLoad(&values[side]) {
        atomicMax(&values[side], bits);
    }
}

@compute @workgroup_size(WG_SIZE)
fn probe_fronts(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= args[3] {
        return;
    }
    let quad = active_quad(list[index]);
    let cell = quad_cell(level, quad);
    let lanes = bit_lanes(flags[quad]);
    let phi = liquid_distance[quad];
    let strides = vec3<u32>(1u, level.stride_y, level.stride_z);
    for (var side = 0u; side < 6u; side++) {
        if (sides.x >> side & 1u) == 0u {
            continue;
        }
        let lower = side >= 3u;
        let stride = strides[side % 3u];
        var next = liquid_distance[select(quad + stride, quad - stride, lower)];
        if side == 0u {
            next = shift_down(phi, next);
        }
        if side == 3u {
            next = shift_up(next, phi);
        }
        raise(side, cell, lanes, phi, next);
    }
}
