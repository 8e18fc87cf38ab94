// move_solid, first part, for free and hinged corotational bodies: rotation correction, which moves nodes on circles
// instead of tangents (twin: reference/turn_solids.rs). With c, v_c the centroid and its velocity, r = x - c, I = sum
// m (|r|^2 1 - r r^T), L = sum m r x v:
//     w = I^-1 L;  y + dt/2 (I^-1 y) x y = L,  theta = dt I^-1 y;  k = 1 / (1 + |theta|^2 / 4)
//     s = (theta - dt w) x r + k (theta x (theta x r) / 2 - |theta|^2 theta x r / 4),  r' = r + dt (v - v_c) + s
//     dv = (I'^-1 sum m (v - v_c) x s) x r';  u += s - dt dv,  v += dv.
// For a body constrained at a point, c is the point and v_c = 0. For a hinge, two of its nodes far apart, I^-1 is e
// e^T / (e . I e) and theta = dt w. So it is for rollers along a coordinate axis e, about the centroid.
// One workgroup per body; sums in a tree.
// step. turning: first node and the one after the last, nodes of the hinge; or FREE, axis of rollers or FREE. rest: m, kg. flags: see
// node_flags. displacement: larger parts, then smaller, m; velocity: m/s; both in place.
#import dispatch
#import node_flags
#import pair
#import real
#import solid_step
#import tree

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> turning: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> rest: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read_write> displacement: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> velocity: array<Real4>;

// Replaces the nodes of a hinge for a body that rotates about its centroid. Also in fields/solids.rs.
const FREE = 0xffffffffu;

// Smallest determinant of an inertia tensor over the cube of its trace, and smallest moment about a hinge over the
// trace (reason in the twin).
const LEAST_INERTIA = 1e-5;
// Iterations of Newton's method, and the squared relative residual of L that it allows.
const ROUNDS = 5;
const LEFT = 1e-6;

struct Tensor {
    inverse: Real3x3,
    // Whether the inverse exists.
    regular: bool,
}

// Rigid part of a body's motion.
struct Motion {
    // Direction of the hinge or of the axis of rollers; 0 for other bodies.
    hinge: Real3,
    centroid: Real3,
    velocity: Real3,
    w: Real3,
    theta: Real3,
}

fn displacement_of(node: u32) -> Pair {
    return Pair(displacement[node].xyz, displacement[step.n_nodes + node].xyz);
}

fn position(node: u32) -> Real3 {
    return Real3(rest[node].xyz) + pair_value(displacement_of(node));
}

fn sum_of(part: Real4, lane: u32) -> Real4 {
    // All threads must read the last sum before it is overwritten.
    workgroupBarrier();
    return tree(part, lane);
}

// Inertia tensor from the sums of m (|r|^2 - r r) and m (yz, zx, xy).
fn tensor(hinge: Real3, diagonal: Real3, products: Real3) -> Tensor {
    let a = Real3(diagonal.x, -products.z, -products.y);
    let b = Real3(-products.z, diagonal.y, -products.x);
    let c = Real3(-products.y, -products.x, diagonal.z);
    let trace = diagonal.x + diagonal.y + diagonal.z;
    if any(hinge != Real3()) {
        let about = dot(hinge, Real3x3(a, b, c) * hinge);
        let turns = about > Real(LEAST_INERTIA) * trace;
        let share = select(Real(), Real(1.0) / about, turns) * hinge;
        return Tensor(Real3x3(share * hinge.x, share * hinge.y, share * hinge.z), turns);
    }
    let determinant = dot(a, cross(b, c));
    let regular = determinant > Real(LEAST_INERTIA) * trace * trace * trace;
    let by = select(Real(), Real(1.0) / determinant, regular);
    return Tensor(Real3x3(by * cross(b, c), by * cross(c, a), by * cross(a, b)), regular);
}

fn diagonal_of(r: Real3) -> Real3 {
    return Real3(dot(r, r)) - r * r;
}

// Angular velocity of the implicit midpoint rule.
fn midway(inverse: Real3x3, momentum: Real3) -> Real3 {
    let half = Real(0.5) * Real(step.dt);
    var y = momentum;
    var left = Real3();
    for (var round = 0; round <= ROUNDS; round++) {
        let w = inverse * y;
        left = y + half * cross(w, y) - momentum;
        if round == ROUNDS {
            break;
        }
        let a = Real3(Real(1.0), Real(), Real()) + half * (cross(w, Real3(Real(1.0), Real(), Real())) - cross(y, inverse[0]));
        let b = Real3(Real(), Real(1.0), Real()) + half * (cross(w, Real3(Real(), Real(1.0), Real())) - cross(y, inverse[1]));
        let c = Real3(Real(), Real(), Real(1.0)) + half * (cross(w, Real3(Real(), Real(), Real(1.0))) - cross(y, inverse[2]));
        let bc = cross(b, c);
        y -= Real3(dot(bc, left), dot(cross(c, a), left), dot(cross(a, b), left)) / dot(a, bc);
    }
    let found = dot(left, left) <= Real(LEFT) * dot(momentum, momentum);
    return inverse * select(momentum, y, found);
}

fn shift(motion: Motion, r: Real3) -> Real3 {
    let theta = motion.theta;
    let square = dot(theta, theta);
    let k = Real(1.0) / (Real(1.0) + Real(0.25) * square);
    let tangent = cross(theta, r);
    let turned = Real(0.5) * cross(theta, tangent) - (Real(0.25) * square) * tangent;
    return cross(theta - Real(step.dt) * motion.w, r) + k * turned;
}

@compute @workgroup_size(FOLD_SIZE)
fn turn_solids(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let body = group_index(workgroup);
    // Workgroups beyond the last body have no nodes, but must not return before the barriers.
    var nodes = vec4<u32>();
    if body < arrayLength(&turning) {
        nodes = turning[body];
    }
    var of_x = Real4();
    var of_v = Real3();
    for (var node = nodes.x + lane; node < nodes.y; node += FOLD_SIZE) {
        let mass = Real(rest[node].w);
        of_x += mass * Real4(position(node), Real(1.0));
        of_v += mass * velocity[node].xyz;
    }
    of_x = sum_of(of_x, lane);
    of_v = sum_of(Real4(of_v, Real()), lane).xyz;
    var motion = Motion(Real3(), of_x.xyz / of_x.w, of_v / of_x.w, Real3(), Real3());
    if nodes.z != FREE && body < arrayLength(&turning) {
        motion.centroid = position(nodes.z);
        motion.velocity = Real3();
        let way = position(nodes.w) - motion.centroid;
        if any(way != Real3()) {
            motion.hinge = way / length(way);
        }
    } else if nodes.z == FREE && nodes.w != FREE {
        motion.hinge = select(Real3(), Real3(Real(1.0)), vec3<u32>(nodes.w) == vec3<u32>(0u, 1u, 2u));
    }

    var momentum = Real3();
    var diagonal = Real3();
    var products = Real3();
    for (var node = nodes.x + lane; node < nodes.y; node += FOLD_SIZE) {
        let mass = Real(rest[node].w);
        let r = position(node) - motion.centroid;
        momentum += mass * cross(r, velocity[node].xyz - motion.velocity);
        diagonal += mass * diagonal_of(r);
        products += mass * r.yzx * r.zxy;
    }
    momentum = sum_of(Real4(momentum, Real()), lane).xyz;
    diagonal = sum_of(Real4(diagonal, Real()), lane).xyz;
    products = sum_of(Real4(products, Real()), lane).xyz;
    let before = tensor(motion.hinge, diagonal, products);
    motion.w = before.inverse * momentum;
    motion.theta = Real(step.dt) * motion.w;
    if all(motion.hinge == Real3()) {
        motion.theta = Real(step.dt) * midway(before.inverse, momentum);
    }

    var lost = Real3();
    diagonal = Real3();
    products = Real3();
    for (var node = nodes.x + lane; node < nodes.y; node += FOLD_SIZE) {
        let mass = Real(rest[node].w);
        let r = position(node) - motion.centroid;
        let v = velocity[node].xyz - motion.velocity;
        let s = shift(motion, r);
        let end = r + Real(step.dt) * v + s;
        lost += mass * cross(v, s);
        diagonal += mass * diagonal_of(end);
        products += mass * end.yzx * end.zxy;
    }
    lost = sum_of(Real4(lost, Real()), lane).xyz;
    diagonal = sum_of(Real4(diagonal, Real()), lane).xyz;
    products = sum_of(Real4(products, Real()), lane).xyz;
    if !before.regular {
        return;
    }
    let dw = tensor(motion.hinge, diagonal, products).inverse * lost;
    for (var node = nodes.x + lane; node < nodes.y; node += FOLD_SIZE) {
        if !any(is_free(flags[node])) {
            continue;
        }
        let r = position(node) - motion.centroid;
        let v = velocity[node].xyz;
        let s = shift(motion, r);
        let dv = cross(dw, r + Real(step.dt) * (v - motion.velocity) + s);
        let u = pair_plus(displacement_of(node), s - Real(step.dt) * dv, step.zero);
        displacement[node] = vec4<f32>(u.hi, 0.0);
        displacement[step.n_nodes + node] = vec4<f32>(u.lo, 0.0);
        velocity[node] = Real4(v + dv, Real());
    }
}
