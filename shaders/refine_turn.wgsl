// Outer loop, one workgroup, between rounds: judges the true residual and opens the next round or ends the solve.
// A correction that made the residual worse is taken back: the best iterate is kept. So is a guess that is worse than none.
// totals: where the number of partials stands. settings: tolerances. args, gated: see control.
// partials: |r|^2 in x; in w |D x|^2 or 0.
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

// A round aims below what is left, so that rounding does not make it miss by a hair.
const ROUND_MARGIN = 0.5;

// Storing x rounds each of its values by half an EPSILON at most, which changes a row of A x by EPSILON times its part of D x if
// neighbours round apart, all as far as they can; by a third of that where they round at random.
const ROUNDING_OF_X = 0.5;

@compute @workgroup_size(FOLD_SIZE)
fn refine_turn(@builtin(local_invocation_index) lane: u32) {
    let sums = fold(args[totals.args + 3u], lane);
    let rr = sums.x;
    if lane != 0u || control.running == 1u {
        return;
    }
    if control.status == STATUS_CONVERGED || control.status == STATUS_STAGNATED
        || control.status == STATUS_MAX_ITERATIONS {
        // Also after a correction was taken back.
        gate_extra(TURN, false);
        return;
    }
    // The first round broke down in its first step: it has corrected nothing, so that there is nothing to take back. Later rounds may, where
    // what is left is rounding; that is stagnation.
    let broke_down = control.status == STATUS_BREAKDOWN && control.rounds == 1u;
    let worse = rr >= norms[NORM_LAST] && !broke_down;
    if worse {
        norms[SCALE] = -norms[SCALE];
        if control.rounds == 0u && norms[SCALE] < Real(0.0) {
            // Back to the start, which is judged next.
            norms[NORM_LAST] = Real(3e38);
            return;
        }
        control.status = STATUS_STAGNATED;
        return;
    }
    norms[NORM_R] = rr;
    let tolerance = Real(settings.tolerance);
    let rounding = Real(settings.rounding);
    let of_x = Real(ROUNDING_OF_X) * EPSILON;
    let of_terms = max(rounding * rounding * norms[NORM_TERMS], of_x * of_x * sums.w);
    let goal = max(tolerance * tolerance * norms[NORM_B], of_terms);
    if rr <= goal {
        control.status = STATUS_CONVERGED;
    } else if control.iterations >= control.max_iterations {
        control.status = STATUS_MAX_ITERATIONS;
    } else if control.status != STATUS_BREAKDOWN {
        norms[NORM_LAST] = rr;
        norms[SCALE] = sqrt(rr);
        let margin = Real(ROUND_MARGIN);
        let floor = Real(settings.round_floor);
        scalars[GOAL] = Inner(max(margin * margin * goal / rr, floor * floor));
        control.running = 1u;
        control.first = 1u;
        control.rounds++;
        gate_lists(true);
        gate_extra(UPDATE, true);
        gate_extra(BEGIN, true);
    }
    gate_extra(TURN, false);
}
