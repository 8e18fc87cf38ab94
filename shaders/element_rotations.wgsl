// solid_matrices, first part: per element the rotation R of the deformation gradient F = I + H, the rotated
// gradients, and the elastic forces K x* - b from differences of displacements,
//     H = sum over corners a = 1, 2, 3 of (u_a - u_0) g_a^T,  eps = sym(R^T F) - I,  P = 2 mu eps + lambda tr(eps) I,
//     (K x* - b)_a = V R P g_a,  energy = V (mu eps : eps + lambda/2 tr(eps)^2).
// One thread per element.
// step. elements: nodes. displacement: larger parts, then smaller, m. rest_gradients: g_1, g_2, g_3 (1/m) with V
// (m^3), lambda, mu (Pa). damping: tau_K (s), 1 for the linear model (R = I) or 0. rotated: R g_1, R g_2, R g_3 with
// zeta_K V lambda, zeta_K V mu, det F. element_forces: at corners 1, 2, 3, N, with the energy (J), 0, 0.
#import dispatch
#import pair
#import polar
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> elements: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> displacement: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> rest_gradients: array<Real4>;
@group(0) @binding(4) var<storage, read> damping: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read_write> rotated: array<Real4>;
@group(0) @binding(6) var<storage, read_write> element_forces: array<Real4>;

fn displacement_of(node: u32) -> Pair {
    return Pair(displacement[node].xyz, displacement[step.n_nodes + node].xyz);
}

@compute @workgroup_size(WG_SIZE)
fn element_rotations(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let element = linear_index(workgroup, lane);
    let n = step.n_elements;
    if element >= n {
        return;
    }
    let nodes = elements[element];
    let u0 = displacement_of(nodes.x);
    let d1 = pair_difference(displacement_of(nodes.y), u0, step.zero);
    let d2 = pair_difference(displacement_of(nodes.z), u0, step.zero);
    let d3 = pair_difference(displacement_of(nodes.w), u0, step.zero);
    let rest1 = rest_gradients[element];
    let rest2 = rest_gradients[n + element];
    let rest3 = rest_gradients[2u * n + element];
    let g1 = rest1.xyz;
    let g2 = rest2.xyz;
    let g3 = rest3.xyz;
    let one = identity();
    let h = Real3x3(
        d1 * g1.x + d2 * g2.x + d3 * g3.x,
        d1 * g1.y + d2 * g2.y + d3 * g3.y,
        d1 * g1.z + d2 * g2.z + d3 * g3.z,
    );
    let f = one + h;
    let material = damping[element];
    var rotation = one;
    if material.y == 0.0 {
        rotation = nearest_rotation(f);
    }
    // sym(R^T F) - I without a difference of numbers near 1: with Z = R - I it is sym(R^T (H - Z)) + (R^T R - I) / 2.
    // The second term compensates the rounding of R in the first.
    let z = rotation - one;
    let turned_back = transpose(rotation) * (h - z);
    let defect = (z + transpose(z)) + transpose(z) * z;
    let half = Real(0.5);
    let strain = half * ((turned_back + transpose(turned_back)) + defect);

    let volume = rest1.w;
    let lambda = rest2.w;
    let mu = rest3.w;
    let dilation = strain[0].x + strain[1].y + strain[2].z;
    let stress = (Real(2.0) * mu) * strain + (lambda * dilation) * one;
    let force = rotation * (volume * stress);
    let square = dot(strain[0], strain[0]) + dot(strain[1], strain[1]) + dot(strain[2], strain[2]);
    let energy = volume * (mu * square + half * lambda * dilation * dilation);
    let zeta_k_volume = (Real(step.elastic * step.dt) + Real(step.damped * material.x)) * volume;
    rotated[element] = Real4(rotation * g1, zeta_k_volume * lambda);
    rotated[n + element] = Real4(rotation * g2, zeta_k_volume * mu);
    rotated[2u * n + element] = Real4(rotation * g3, dot(f[0], cross(f[1], f[2])));
    element_forces[element] = Real4(force * g1, energy);
    element_forces[n + element] = Real4(force * g2, Real());
    element_forces[2u * n + element] = Real4(force * g3, Real());
}
