#import components

// A cavity of a solid and the liquid in it: stages::Cavity is the same struct on the host.
struct Cavity {
    // smallest root of the sealed components that touch it; NONE for none
    root: u32,
    // open volume of that component, 2^-24 cells: low and high words
    low: u32,
    high: u32,
    // source, volumes of a cell per second
    source: f32,
    // least and largest open volume that fill the cavity, cells
    least: f32,
    largest: f32,
}

// Open volume of the component, cells.
fn open_cells(cavity: Cavity) -> f32 {
    return f32(cavity.high) * 256.0 + f32(cavity.low) / 16777216.0;
}

fn is_filled(cavity: Cavity) -> bool {
    let open = open_cells(cavity);
    return cavity.root != NONE && open >= cavity.least && open <= cavity.largest;
}
