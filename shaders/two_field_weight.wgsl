// Two-field PCG, start of a refinement step, last, one workgroup: g_p and r_v are to weigh the same in the norm that ends the refinement step;
// its goal is that part of what the refinement step starts from.
// coupling. partials: those of the wet quads: what couple_begin added to |g_p|^2. norms: see refine. control: the state. scalars: see pcg_slots.
#import control_state
#import coupling
#import fold
#import inner
#import pcg_slots
#import real
#import refine

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> partials: array<Real4>;
@group(0) @binding(2) var<storage, read> norms: array<Real>;
@group(0) @binding(3) var<storage, read> control: Control;
@group(0) @binding(4) var<storage, read_write> scalars: array<Inner>;

const NEGLIGIBLE = 1e-30;

@compute @workgroup_size(FOLD_SIZE)
fn two_field_weight(@builtin(local_invocation_index) lane: u32) {
    let of_quads = fold_from(0u, coupling.n_wet, lane);
    // Only where a refinement step has been opened and has made no step.
    if lane != 0u || control.running == 0u || control.first == 0u {
        return;
    }
    let scale = norms[SCALE];
    let gg_p = max(norms[norm_slot(0u, RESIDUAL)] / (scale * scale) + of_quads.x, Real(0.0));
    let rr_v = norms[norm_slot(1u, RESIDUAL)] / (scale * scale);
    // Where one of them is nothing the other decides.
    var weight = Real(1.0);
    if gg_p > Real(NEGLIGIBLE) && rr_v > Real(NEGLIGIBLE) {
        weight = gg_p / rr_v;
    }
    scalars[WEIGHT] = Inner(weight);
    scalars[GOAL] *= Inner(gg_p + weight * rr_v);
}
