// liquid_distance, third of five: every marker near an empty cell lowers the squared distance of the wanting cells
// within reach.
// An atomic minimum of the bits, which are ordered like positive floats, is independent of the order and repeats bit
// for bit. One thread per marker.
// level, step. markers: x, y, z (m), w = 1 alive. occupied: see classes. squares: cells^2, as bits; in place.
#import dispatch
#import layout
#import step
#import classes

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> markers: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> occupied: array<u32>;
@group(0) @binding(4) var<storage, read_write> squares: array<atomic<u32>>;

// Reach of a marker, cells, and its square.
const REACH = 2.0;
const REACH_SQUARED = 4.0;
// A cell with a marker has one within half its diagonal, sqrt(3)/2, so markers further away cannot be the nearest.
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
    let own = cell_index(level, cell) / 4u;
    if (lanes_of(occupied[own], SPREADING) >> (cell.x % 4u) & 1u) == 0u {
        return;
    }
    // Along each axis at most four cell centres are within reach.
    let low = vec3<u32>(max(ceil(at - 0.5 - REACH), vec3<f32>()));
    let high = min(vec3<u32>(at - 0.5 + REACH), level.cells - 1u);
    // Index of the first of these among the eight cells in the quad's word, and their number.
    let start = low.x + 2u - 4u * (cell.x / 4u);
    let n = high.x - low.x + 1u;
    for (var z = low.z; z <= high.z; z++) {
        let dz = f32(z) + 0.5 - at.z;
        for (var y = low.y; y <= high.y; y++) {
            let dy = f32(y) + 0.5 - at.y;
            let across = dy * dy + dz * dz;
            if across >= REACH_SQUARED {
                continue;
            }
            let row = level.stride_z * (z + 1u) + level.stride_y * y;
            let word = occupied[row + cell.x / 4u];
            let empty = extractBits(word, EMPTY_ROW + start, n);
            var bits = empty;
            if across < REACH_OCCUPIED_SQUARED {
                bits = extractBits(word, WANTING_ROW + start, n);
            }
            while bits != 0u {
                let bit = firstTrailingBit(bits);
                bits &= bits - 1u;
                let x = low.x + bit;
                let dx = f32(x) + 0.5 - at.x;
                let square = dx * dx + across;
                if square < select(REACH_OCCUPIED_SQUARED, REACH_SQUARED, (empty >> bit & 1u) != 0u) {
                    let slot = 4u * row + x;
                    if bitcast<u32>(square) < atomicLoad(&squares[slot]) {
                        atomicMin(&squares[slot], bitcast<u32>(square));
                    }
                }
            }
        }
    }
}
