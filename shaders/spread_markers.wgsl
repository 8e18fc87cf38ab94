// liquid_distance, third of five: every marker near an empty cell lowers the squared distance of the cells within reach that
// want one. The bits of positive floats are ordered like the floats, and a minimum has no order, so an atomic minimum of integers
// repeats bit for bit. One thread per marker.
// level, step. markers: x, y, z (m), w = 1 alive. occupied, classes: see classes. squares: cells^2, as bits; in place.
#import dispatch
#import layout
#import step
#import classes

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> markers: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> occupied: array<u32>;
@group(0) @binding(4) var<storage, read> classes: array<u32>;
@group(0) @binding(5) var<storage, read_write> squares: array<atomic<u32>>;

// Cells that markers reach, and its square.
const REACH = 2;
const REACH_SQUARED = 4.0;
// A cell that holds a marker has one within half its diagonal, sqrt(3)/2: those further away cannot be its nearest.
const REACH_OCCUPIED_SQUARED = 0.76;

@compute @workgroup_size(WG_SIZE)
fn spread_markers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= step.n_markers {
        return;
    }
    let marker = markers[index];
    if marker.w == 0.0 {
        return;
    }
    let at = marker.xyz * step.inv_dx;
    let cell = cell_of(level, at);
    let own = level.stride_z * (cell.z + 1u) + level.stride_y * cell.y + cell.x / 4u;
    if (lanes_of(occupied[own], SPREADING) >> (cell.x % 4u) & 1u) == 0u {
        return;
    }
    let low = vec3<u32>(max(vec3<i32>(cell) - REACH, vec3<i32>()));
    let high = min(cell + u32(REACH), level.cells - 1u);
    for (var z = low.z; z <= high.z; z++) {
        let dz = f32(z) + 0.5 - at.z;
        for (var y = low.y; y <= high.y; y++) {
            let dy = f32(y) + 0.5 - at.y;
            let across = dy * dy + dz * dz;
            if across >= REACH_SQUARED {
                continue;
            }
            let row = level.stride_z * (z + 1u) + level.stride_y * y;
            // Five cells lie in two quads: their lanes side by side.
            let first = row + low.x / 4u;
            let second = row + high.x / 4u;
            let two = vec2<u32>(classes[first], classes[second]);
            let wanting = lanes_of(two.x, WANTING) | lanes_of(two.y, WANTING) << 4u;
            if wanting == 0u {
                continue;
            }
            let empty = lanes_of(two.x, EMPTY) | lanes_of(two.y, EMPTY) << 4u;
            for (var x = low.x; x <= high.x; x++) {
                let bit = 1u << (x - 4u * (low.x / 4u));
                if (wanting & bit) == 0u {
                    continue;
                }
                let dx = f32(x) + 0.5 - at.x;
                let square = dx * dx + across;
                if square < select(REACH_OCCUPIED_SQUARED, REACH_SQUARED, (empty & bit) != 0u) {
                    let bits = bitcast<u32>(square);
                    let slot = 4u * row + x;
                    if bits < atomicLoad(&squares[slot]) {
                        atomicMin(&squares[slot], bits);
                    }
                }
            }
        }
    }
}
