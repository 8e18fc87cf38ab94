// solve, for solids, active-set search: the fraction of the step from the best velocity to the minimiser at which the
// first penetrating node reaches its surface.
// One thread per node.
// step. gaps: see contact. best, velocity: from and to, m/s. answer: see ask; bits of the fraction, initially 1: the
// bits of positive floats are ordered like the floats.
#import ask
#import contact
#import dispatch
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> gaps: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> best: array<Real4>;
@group(0) @binding(3) var<storage, read> velocity: array<Real4>;
@group(0) @binding(4) var<storage, read_write> answer: array<atomic<u32>>;

// Fraction of a step at which a gap closes.
fn stop(before: Real, after: Real) -> f32 {
    let start = max(before, Real());
    return f32(start / (start - after));
}

@compute @workgroup_size(WG_SIZE)
fn first_stop(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let walls = gaps[node];
    let dt = Real(step.dt);
    let near = Real(f32(NEAR) * step.dx);
    let v = best[node].xyz;
    let w = velocity[node].xyz;
    var first = 1.0;
    let before = wall_gaps(walls, v, dt);
    let after = wall_gaps(walls, w, dt);
    let free = is_free(u32(walls.w));
    let passed = free & (after < Real3(-near)) & (after < before);
    for (var axis = 0; axis < 3; axis++) {
        if passed[axis] {
            first = min(first, stop(before[axis], after[axis]));
        }
    }
    if arrayLength(&gaps) > step.n_nodes {
        let surface = gaps[step.n_nodes + node];
        let n = Real3(surface.xyz);
        let before = Real(surface.w) + dt * dot(v, n);
        let after = Real(surface.w) + dt * dot(w, n);
        if any(shared_direction(walls, surface.xyz) != Real3()) && after < -near && after < before {
            first = min(first, stop(before, after));
        }
    }
    if first < 1.0 {
        atomicMin(&answer[ANSWER], bitcast<u32>(first));
    }
}
