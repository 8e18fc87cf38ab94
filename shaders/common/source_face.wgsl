// A face of a source cell: fields::DeviceSourceFace on the host.
#import source_step

struct SourceFace {
    // Index among the faces of all axes, device layout.
    face: u32,
    // Sources of the cells on the minus side (low byte) and on the plus side; 255 for none.
    sides: u32,
    // Velocities of both along the axis, m/s.
    minus: f32,
    plus: f32,
    // Apertures of their flux where the other side is no source.
    minus_aperture: f32,
    plus_aperture: f32,
    pad_0: u32,
    pad_1: u32,
}

// Prescribed velocity of a face, m/s, if any, and the aperture of its flux.
struct Held {
    is: bool,
    velocity: f32,
    aperture: f32,
}

// Between cells of sources their velocity, else the velocity out of the source; no inflow.
fn held(face: SourceFace, running: u32) -> Held {
    let minus = runs(face.sides & 255u, running);
    let plus = runs(face.sides >> 8u, running);
    let velocity = select(min(face.plus, 0.0), max(face.minus, 0.0), minus);
    let aperture = select(face.plus_aperture, face.minus_aperture, minus);
    let inner = minus && plus;
    return Held(minus || plus, select(velocity, face.minus, inner), select(aperture, 1.0, inner));
}
