// solve with separation, after separation_scale: the next set. It separates candidates with a pressure below 0, and lets
// separated cells back that would close.
// One thread per quad of the band.
// level. separation_round: see below. band_args, band_list: the band. flags: see active, without separated lanes. open: apertures for the
// pressure. potential, rhs: m/s. separated: see separation; the next set, in place. separation_sums: see separation.
#import dispatch
#import lanes
#import opening
#import separation

struct SeparationRound {
    // Whether cells let back now do not separate again: 0 or 1.
    locks: u32,
    // Least rate of closing that counts, relative to the largest right-hand side: the tolerance of the last solve.
    tolerance: f32,
    pad_0: u32,
    pad_1: u32,
}

// Fraction of the largest potential below which a negative one is rounding.
const ROUNDING = 1e-6;

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> separation_round: SeparationRound;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read> open: array<f32>;
@group(0) @binding(6) var<storage, read> potential: array<Real4>;
@group(0) @binding(7) var<storage, read> rhs: array<Real4>;
@group(0) @binding(8) var<storage, read_write> separated: array<u32>;
@group(0) @binding(9) var<storage, read_write> separation_sums: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn separation_update(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let word = separated[quad];
    if word == 0u {
        return;
    }
    let now = word & 15u;
    let candidates = word >> CANDIDATES & 15u;
    let least = -ROUNDING * bitcast<f32>(atomicLoad(&separation_sums[LARGEST_POTENTIAL]));
    let closing = -separation_round.tolerance * bitcast<f32>(atomicLoad(&separation_sums[LARGEST_RHS]));
    let cell = quad_cell(level, quad);
    let p = vec4<f32>(potential[quad]);
    let b = rhs[quad];
    var added = 0u;
    var returned = 0u;
    for (var l = 0u; l < 4u; l++) {
        let bit = 1u << l;
        if (now & bit) != 0u {
            if f32(opening(cell + vec3<i32>(i32(l), 0, 0), b[l])) < closing {
                returned |= bit;
            }
        } else if (candidates & bit) != 0u {
            if p[l] < least && (word >> LOCKED & bit) == 0u {
                added |= bit;
            }
        }
    }
    if now != 0u {
        atomicAdd(&separation_sums[SEPARATED], countOneBits(now));
    }
    if added != 0u {
        atomicAdd(&separation_sums[ADDED], countOneBits(added));
    }
    if returned != 0u {
        atomicAdd(&separation_sums[RETURNED], countOneBits(returned));
    }
    let locked = (word >> LOCKED & 15u) | select(0u, returned, separation_round.locks != 0u);
    let next = (now | added) & ~returned | locked << (NEXT_LOCKED - NEXT);
    separated[quad] = (word & PRESENT) | next << NEXT;
}
