// PCG, one workgroup: alpha = r . z / s . q, and the state machine. |r|^2 after the update follows from the same sums, so a refinement step that
// ends here does not start another V-cycle.
// It is not carried over from step to step: its rounding would pile up where the residual rises first.
// totals: where the number of partials stands. args, gated: see control. partials: s . q, r . q, q . q, r . r.
#import level
#import pcg_slots
#import real
#import control
#import fold

@group(0) @binding(0) var<uniform> totals: Level;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> partials: array<Real4>;
@group(0) @binding(3) var<storage, read_write> scalars: array<Real>;
@group(0) @binding(4) var<storage, read_write> control: Control;
@group(0) @binding(5) var<storage, read_write> gated: array<u32>;

@compute @workgroup_size(FOLD_SIZE)
fn pcg_alpha(@builtin(local_invocation_index) lane: u32) {
    let sums = fold(args[totals.args + 3u], lane);
    if lane != 0u {
        return;
    }
    if control.running == 0u {
        gate_extra(UPDATE, false);
        return;
    }
    control.iterations++;
    var ends = control.iterations >= control.max_iterations;
    if sums.x > Real(0.0) {
        let alpha = scalars[RZ] / sums.x;
        let rr = max(sums.w - alpha * (Real(2.0) * sums.y - alpha * sums.z), Real(0.0));
        scalars[ALPHA] = alpha;
        ends |= rr <= scalars[GOAL];
    } else {
        scalars[ALPHA] = Real(0.0);
        // Later in a refinement step s is down to rounding, and the evaluation judges what was reached.
        control.status = select(control.status, STATUS_BREAKDOWN, control.first == 1u);
        ends = true;
    }
    control.first = 0u;
    if ends {
        control.running = 0u;
        gate_lists(false);
        gate_extra(EVALUATE, true);
    }
}
