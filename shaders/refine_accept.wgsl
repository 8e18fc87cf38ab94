// Outer loop, one workgroup, after a residual evaluation: accepts or rejects the correction, and begins the next refinement step or ends
// the solve. solver/acceptance.rs is the same rule on the host.
// A block passes where its |r|^2 is at most its allowed error; all must. Corrections are compared by the largest |r|^2 over the allowed error.
// A rejected correction, or a guess that is worse than zero, is subtracted before the next evaluation.
// totals: where the number of partials stands. settings: see refine. args, gated: see control.
// partials: evaluation of the first block; second sum: squared right-hand side with the coupling.
// norms: see refine, with the evaluations of the other blocks; second sum: squared terms with those of the coupling.
#import level
#import refine
#import pcg_slots
#import inner
#import control
#import fold

@group(0) @binding(0) var<uniform> totals: Level;
@group(0) @binding(1) var<uniform> settings: RefineSettings;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> partials: array<Real4>;
@group(0) @binding(4) var<storage, read_write> norms: array<Real>;
@group(0) @binding(5) var<storage, read_write> scalars: array<Inner>;
@group(0) @binding(6) var<storage, read_write> control: Control;
@group(0) @binding(7) var<storage, read_write> gated: array<u32>;

// Rounding of a stored unknown in units of EPSILON: a row of A x changes by EPSILON times its part of D x where neighbours round apart, by
// a third of that where they round at random.
const ROUNDING_OF_X = 0.5;
// Square of the share of the coupling terms that residuals are relative to where it is more than the right-hand side: a body that moves
// in a liquid at rest is all that acts on the liquid.
const COUPLING_SHARE = 1e-4;
// Inner tolerance relative to the allowed error, for one block and for more: the norm of conjugate gradients is not that of their residuals.
const MARGIN = 0.5;
const MARGIN_COUPLED = 0.3;
// Factor of the inner tolerance after a rejected correction of several blocks; one block is not corrected again.
const RETRY_COUPLED = 0.03;
// Least strictness.
const STRICTEST = 1e-5;
// Above every error.
const NONE = 3e38;
const MAX_BLOCKS = 2u;

// Whether the iterate is zero and no guess was tried.
fn at_zero() -> bool {
    return control.refinements == 0u && norms[SCALE] == Real(0.0);
}

// Of a block: squared residual, reference, allowed error.
fn judge(block: u32, sums: Real4) -> Real3 {
    var of_block = sums;
    if block > 0u {
        let at = evaluation_slot(block, settings.n_blocks);
        of_block = Real4(norms[at], norms[at + 1u], norms[at + 2u], norms[at + 3u]);
    }
    let coupled = settings.n_blocks > 1u;
    if coupled && at_zero() {
        norms[norm_slot(block, RHS)] = of_block.x;
        if block > 0u {
            norms[norm_slot(block, TERMS)] = of_block.y;
            control.unknowns += u32(of_block.z);
        }
    }
    let terms = norms[norm_slot(block, TERMS)];
    var reference = norms[norm_slot(block, RHS)];
    if coupled {
        let coupling = select(of_block.y, max(of_block.y - terms, Real(0.0)), block > 0u);
        reference = max(reference, Real(COUPLING_SHARE) * coupling);
    }
    let tolerance = Real(settings.tolerance);
    let rounding = Real(settings.rounding);
    let of_x = Real(ROUNDING_OF_X) * EPSILON;
    let of_terms = max(rounding * rounding * terms, of_x * of_x * of_block.w);
    return Real3(of_block.x, reference, max(max(tolerance * tolerance * reference, of_terms), SMALLEST));
}

@compute @workgroup_size(FOLD_SIZE)
fn refine_accept(@builtin(local_invocation_index) lane: u32) {
    let sums = fold(args[totals.args + 3u], lane);
    if lane != 0u || control.running == 1u {
        return;
    }
    if control.status == STATUS_CONVERGED || control.status == STATUS_STAGNATED
        || control.status == STATUS_MAX_ITERATIONS {
        // Also after a correction was subtracted.
        gate_extra(EVALUATE, false);
        return;
    }
    let coupled = settings.n_blocks > 1u;
    var judged: array<Real3, MAX_BLOCKS>;
    var worst = Real(0.0);
    var rr = Real(0.0);
    for (var block = 0u; block < settings.n_blocks; block++) {
        judged[block] = judge(block, sums);
        worst = max(worst, judged[block].x / judged[block].z);
        rr += judged[block].x;
    }
    // A first step that breaks down corrects nothing: nothing to reject. Later ones may where the rest is rounding: stagnation.
    let broke_down = control.status == STATUS_BREAKDOWN && control.refinements == 1u;
    var last = norms[NORM_LAST];
    let guessed = control.refinements == 0u && norms[SCALE] > Real(0.0);
    if guessed && !coupled {
        last = norms[norm_slot(0u, RHS)] / judged[0].z;
    }
    if coupled && at_zero() && settings.guess > 0.0 && worst > Real(1.0) {
        norms[NORM_LAST] = worst;
        norms[SCALE] = Real(settings.guess);
        return;
    }
    if (guessed || control.refinements > 0u) && worst >= last && !broke_down {
        norms[SCALE] = -norms[SCALE];
        norms[NORM_LAST] = Real(NONE);
        if guessed {
            return;
        }
        norms[STRICTNESS] *= select(Real(0.0), Real(RETRY_COUPLED), coupled);
        if norms[STRICTNESS] < Real(STRICTEST) || control.status == STATUS_BREAKDOWN
            || control.iterations >= control.max_iterations {
            control.status = STATUS_STAGNATED;
        }
        return;
    }
    for (var block = 0u; block < settings.n_blocks; block++) {
        norms[norm_slot(block, RESIDUAL)] = judged[block].x;
        norms[norm_slot(block, REFERENCE)] = judged[block].y;
    }
    if worst <= Real(1.0) {
        control.status = STATUS_CONVERGED;
    } else if control.iterations >= control.max_iterations {
        control.status = STATUS_MAX_ITERATIONS;
    } else if control.status != STATUS_BREAKDOWN {
        norms[NORM_LAST] = worst;
        norms[SCALE] = sqrt(rr);
        let margin = select(Real(MARGIN), Real(MARGIN_COUPLED), coupled);
        let floor = Real(settings.floor);
        let strictness = norms[STRICTNESS];
        scalars[GOAL] = Inner(strictness * strictness * max(margin * margin / worst, floor * floor));
        control.running = 1u;
        control.first = 1u;
        control.refinements++;
        gate_lists(true);
        gate_extra(UPDATE, true);
        gate_extra(BEGIN, true);
    }
    gate_extra(EVALUATE, false);
}
