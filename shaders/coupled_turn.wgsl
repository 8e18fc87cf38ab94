// Outer loop of the coupled solve, one workgroup, between rounds: as refine_turn, but both residuals must pass, each by its own
// right-hand side, which are the residuals of the start from zero, or by a hundredth of what the other part puts on its rows, where that is
// more: a body that moves in a liquid at rest is all that acts on the liquid. What is compared from round to round is how far the worse of them is
// from its goal.
// totals: where the number of partials stands. settings: tolerances. args, gated: see control.
// partials: of the pressure's part |r|^2 in x, |b - J v|^2 in y, |D x|^2 in w.
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

// A round aims below what is left: its norm is not that of the residuals that are judged.
const ROUND_MARGIN = 0.3;
// See refine_turn.
const ROUNDING_OF_X = 0.5;
const SMALLEST = 1e-37;
// The share, squared, of what the other part puts on the rows.
const OF_OTHER = 1e-4;
// By what a round is to go further than one that made it worse, and how far at most.
const STRICTER = 0.03;
const STRICTEST = 1e-5;

@compute @workgroup_size(FOLD_SIZE)
fn coupled_turn(@builtin(local_invocation_index) lane: u32) {
    let sums = fold(args[totals.args + 3u], lane);
    if lane != 0u || control.running == 1u {
        return;
    }
    if control.status == STATUS_CONVERGED || control.status == STATUS_STAGNATED
        || control.status == STATUS_MAX_ITERATIONS {
        // Also after a correction was taken back.
        gate_extra(TURN, false);
        return;
    }
    let rr_p = sums.x;
    let rr_v = norms[NORM_R_V];
    if control.rounds == 0u {
        norms[NORM_B] = rr_p;
        norms[NORM_B_V] = rr_v;
        norms[NORM_TERMS_V] = norms[NORM_PUSHED_V];
        control.unknowns += u32(norms[UNKNOWNS_V]);
    }
    let tolerance = Real(settings.tolerance);
    let rounding = Real(settings.rounding);
    let of_x = Real(ROUNDING_OF_X) * EPSILON;
    let pushed = max(norms[NORM_PUSHED_V] - norms[NORM_TERMS_V], Real(0.0));
    let acts_p = max(norms[NORM_B], Real(OF_OTHER) * sums.y);
    let acts_v = max(norms[NORM_B_V], Real(OF_OTHER) * pushed);
    let terms_p = max(rounding * rounding * norms[NORM_TERMS], of_x * of_x * sums.w);
    let terms_v = max(rounding * rounding * norms[NORM_TERMS_V], of_x * of_x * norms[NORM_D_V]);
    let goal_p = max(max(tolerance * tolerance * acts_p, terms_p), Real(SMALLEST));
    let goal_v = max(max(tolerance * tolerance * acts_v, terms_v), Real(SMALLEST));
    let worst = max(rr_p / goal_p, rr_v / goal_v);
    if control.rounds == 0u {
        norms[STRICTNESS] = Real(1.0);
    } else if !(worst < norms[NORM_LAST]) {
        // Taken back in the next turn, also where it is not a number. Where the polynomial is poor for a stiff solid the round may have
        // ended too early for the residual that counts: the next one goes further, until none is worth it.
        norms[SCALE] = -norms[SCALE];
        norms[STRICTNESS] *= Real(STRICTER);
        if norms[STRICTNESS] < Real(STRICTEST) || control.iterations >= control.max_iterations {
            control.status = STATUS_STAGNATED;
        } else {
            norms[NORM_LAST] = Real(3e38);
        }
        return;
    }
    norms[NORM_R] = rr_p;
    norms[NORM_BEST_V] = rr_v;
    norms[NORM_ACTS] = acts_p;
    norms[NORM_ACTS_V] = acts_v;
    if worst <= Real(1.0) {
        control.status = STATUS_CONVERGED;
    } else if control.iterations >= control.max_iterations {
        control.status = STATUS_MAX_ITERATIONS;
    } else if control.status != STATUS_BREAKDOWN {
        norms[NORM_LAST] = worst;
        norms[SCALE] = sqrt(rr_p + rr_v);
        let margin = Real(ROUND_MARGIN);
        let floor = Real(settings.round_floor);
        let strictness = norms[STRICTNESS];
        scalars[GOAL] = Inner(strictness * strictness * max(margin * margin / worst, floor * floor));
        control.running = 1u;
        control.first = 1u;
        control.rounds++;
        gate_lists(true);
        gate_extra(UPDATE, true);
        gate_extra(BEGIN, true);
    }
    gate_extra(TURN, false);
}
