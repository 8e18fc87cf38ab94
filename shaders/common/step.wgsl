// Parameters of a sub-step for the liquid: fields::Step on the host.
struct Step {
    // m/s^2
    gravity: vec3<f32>,
    // s
    dt: f32,
    // Size of the domain, m.
    size: vec3<f32>,
    // m
    dx: f32,
    // 1/m
    inv_dx: f32,
    // Time over which volume is controlled, s.
    control_time: f32,
    // Controlled liquid volume, m^3.
    volume_0: f32,
    // kg/m^3
    density: f32,
    // Radius of the spheres around markers, cells.
    marker_radius: f32,
    n_markers: u32,
    // Open sides of the domain, see walls.
    open_sides: u32,
    // Of the velocity beyond a level, m/s per cell.
    largest_slope: f32,
}
