// extrapolate, after the layers: sets the velocity of faces on closed sides of the domain to zero; with separation
// beside air and separated cells only a velocity beyond the side. One thread per quad of the band.
// level. band_args, band_list: the band. valid: open faces, cells whose walls liquid leaves. velocity: faces, m/s, in place.
#import dispatch
#import face_index
#import layout
#import lanes
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> valid: array<u32>;
@group(0) @binding(4) var<storage, read_write> velocity: array<f32>;

fn close(axis: u32, quad: u32, lane: u32) {
    if (valid[quad] >> (OPEN + 4u * axis + lane) & 1u) == 0u {
        let cell = quad_cell(level, quad) + vec3<i32>(i32(lane), 0, 0);
        let low = cell[axis] == 0;
        let inside = vec3<u32>(cell - select(along(axis), vec3<i32>(), low));
        let face = 4u * (axis * level.quads + quad) + lane;
        var kept = 0.0;
        if all(inside < level.cells) {
            let beside = cell_index(level, inside) / 4u;
            if (valid[beside] >> (LEAVING_FIRST + inside.x % 4u) & 1u) == 1u {
                kept = select(min(velocity[face], 0.0), max(velocity[face], 0.0), low);
            }
        }
        velocity[face] = kept;
    }
}

@compute @workgroup_size(WG_SIZE)
fn extrapolate_walls(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let cell = quad_cell(level, quad);
    let n = vec3<i32>(level.cells);
    if cell.x == 0 {
        close(0u, quad, 0u);
    }
    if cell.x <= n.x && n.x < cell.x + 4 {
        close(0u, quad, u32(n.x - cell.x));
    }
    for (var axis = 1u; axis < 3u; axis++) {
        if cell[axis] == 0 || cell[axis] == n[axis] {
            for (var l = 0u; l < 4u; l++) {
                close(axis, quad, l);
            }
        }
    }
}
