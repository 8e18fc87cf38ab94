// probe, fronts: the largest coordinate of the liquid along each axis over active cells, m. It is the surface between
// an active cell and air, or the far face of a cell at a wall or beside other liquid.
// One thread per active quad.
// level, step. args, list: active quads. flags: see active. liquid_distance: m. values: bits of the three coordinates
// first.
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

// Raises the front along an axis from the distances of a quad of cells and those one cell further.
fn raise(axis: u32, cell: vec3<i32>, lanes: vec4<bool>, phi: vec4<f32>, next: vec4<f32>) {
    var front = 0.0;
    for (var l = 0; l < 4; l++) {
        if lanes[l] {
            let index = cell[axis] + select(0, l, axis == 0u);
            let ends = index + 1 == i32(level.cells[axis]) || next[l] < 0.0;
            let reach = select(0.5 + ghost_theta(phi[l], next[l], 0.0), 1.0, ends);
            front = max(front, (f32(index) + reach) * step.dx);
        }
    }
    // The bits of positive floats are ordered like the floats.
    let bits = bitcast<u32>(front);
    if bits > atomicLoad(&values[axis]) {
        atomicMax(&values[axis], bits);
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
    raise(0u, cell, lanes, phi, shift_down(phi, liquid_distance[quad + 1u]));
    raise(1u, cell, lanes, phi, liquid_distance[quad + level.stride_y]);
    raise(2u, cell, lanes, phi, liquid_distance[quad + level.stride_z]);
}
