// Per face at x, u*(x) = u(x - dt u(x - dt/2 u(x))), trilinear, for the 12 minus faces of a quad (see face_departure).
// The importing kernel declares the variables of advect_quad and face_departure, makes(axis, quad): the lanes to compute, and put(axis, quad,
// made, result): storage of u*, m/s.
#import advect_quad
#import face_departure
#import layout
#import lanes

fn advect(axis: u32, quad: u32, cell: vec3<i32>, u: vec4<f32>, v: vec4<f32>, w: vec4<f32>) {
    let made = makes(axis, quad);
    var moves = lane_bits(made & moving(axis, cell, u, v, w));
    var result = vec4<f32>();
    while moves != 0u {
        let l = firstTrailingBit(moves);
        moves &= moves - 1u;
        let origin = departure(face_at(axis, cell, l), vec3<f32>(u[l], v[l], w[l]));
        result[l] = sample_face(axis, origin);
    }
    put(axis, quad, made, result);
}
