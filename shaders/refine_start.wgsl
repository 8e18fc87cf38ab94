// Outer loop, one workgroup, before the first refinement step: the norms of the right-hand side, the number of unknowns, the state.
// totals: where the number of partials stands. settings: whether there is a guess. args, gated: see control.
// partials: |b|^2, terms^2, unknowns.
#import level
#import refine
#import control
#import fold

@group(0) @binding(0) var<uniform> totals: Level;
@group(0) @binding(1) var<uniform> settings: RefineSettings;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> partials: array<Real4>;
@group(0) @binding(4) var<storage, read_write> norms: array<Real>;
@group(0) @binding(5) var<storage, read_write> control: Control;
@group(0) @binding(6) var<storage, read_write> gated: array<u32>;

@compute @workgroup_size(FOLD_SIZE)
fn refine_start(@builtin(local_invocation_index) lane: u32) {
    let sums = fold(args[totals.args + 3u], lane);
    if lane != 0u {
        return;
    }
    norms[norm_slot(0u, RHS)] = sums.x;
    norms[norm_slot(0u, TERMS)] = sums.y;
    norms[norm_slot(0u, RESIDUAL)] = sums.x;
    norms[NORM_LAST] = Real(3e38);
    // Several blocks are evaluated at zero before a guess: their right-hand sides have terms of the other blocks.
    norms[SCALE] = select(Real(settings.guess), Real(0.0), settings.n_blocks > 1u);
    norms[STRICTNESS] = Real(1.0);
    control.unknowns = u32(sums.z);
    control.running = 0u;
    control.status = STATUS_RUNNING;
    control.iterations = 0u;
    control.refinements = 0u;
    gate_lists(false);
    gate_extra(UPDATE, false);
    gate_extra(EVALUATE, true);
    gate_extra(BEGIN, false);
}
