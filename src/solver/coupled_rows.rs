//! Coupled solves of a sub-step in which solids touch each other (twin: reference/contact_rows.rs).
//!
//! Rows, held rows and the learned response persist between the rounds of separation.

use crate::Error;
use crate::gpu::{Gpu, Recorder, StageTimes, lock};
use crate::linalg::{ForceSearch, HeldRows, Row, RowSearch, UnilateralRows};
use crate::state::{ContactReport, SolveStatus};

use super::contact_rows::{self, HeldSolve, NodeReadbacks, RowsOf};
use super::coupled::{CorrectionForm, CoupledOutcome, CoupledSolver};
use super::plus;
use super::refine::Aim;
use super::schur::{Inverse, Prepared, Schur};
use super::stored_stiffness::Factor;

/// Most solves of a precise round.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowLimits {
    /// Times that rows of meetings join.
    pub(crate) meetings: u32,
    /// Sets of held rows for the same rows.
    pub(crate) sets: u32,
}

/// The coupled solves of a sub-step under the rows of solids that touch each other.
#[derive(Debug)]
pub(crate) struct RowSolves<'a> {
    together: &'a CoupledSolver,
    form: CorrectionForm<'a>,
    /// Whether the Schur-complement form was prepared for the rows, with the wet nodes of a round.
    upgraded: bool,
    /// S^-1, where the form has none.
    factor: Option<Factor<'a>>,
    /// `None` until solids touch.
    contact: Option<Contact>,
}

/// Rows of the sub-step so far, and the search for those to hold.
#[derive(Debug)]
struct Contact {
    rows: Vec<Row>,
    system: UnilateralRows,
    search: RowSearch,
    /// Forces of the rows in the last solve, N; empty before the first.
    lambda: Vec<f64>,
    /// Right-hand side with these forces, N; empty without rounds.
    pushed: Vec<f64>,
    /// Whether the rows are those of a rough round.
    rough: bool,
}

impl Contact {
    /// `free`: velocities without the forces of rows, m/s, four numbers per node.
    fn new(rows: Vec<Row>, n_nodes: usize, factor: &Factor, free: &[f64], rough: bool) -> Contact {
        let system = contact_rows::unilateral(rows.clone(), n_nodes, factor);
        let search = RowSearch::new(&system, free);
        Contact { rows, lambda: Vec::new(), pushed: Vec::new(), system, search, rough }
    }

    /// Takes the tangents of a precise round in place of those of a rough one, where the rows are the same otherwise.
    fn renew(&mut self, rows: Vec<Row>, n_nodes: usize, factor: &Factor) {
        let same = |(a, b): (&Row, &Row)| a.entries == b.entries && a.least == b.least;
        let rubs = self.rows.iter().any(|row| row.friction.is_some());
        if rubs && rows.len() == self.rows.len() && rows.iter().zip(&self.rows).all(same) {
            let system = contact_rows::unilateral(rows.clone(), n_nodes, factor);
            if system.n() == self.system.n() {
                (self.rows, self.system) = (rows, system);
            }
        }
        self.rough = false;
    }
}

/// Solves of a round with the same system of liquid and solids. Vectors with four numbers per node.
#[derive(Debug)]
struct Round<'a, 'b> {
    gpu: &'b Gpu,
    together: &'a CoupledSolver,
    form: &'b CorrectionForm<'a>,
    /// The Schur-complement form, where this is the form.
    schur: Option<(&'a Schur, &'b Inverse<'a>)>,
    factor: &'b Factor<'a>,
    nodes: &'b mut NodeReadbacks,
    aim: Option<Aim>,
    /// Velocities without the forces of rows, m/s: solved for, or with the force of the liquid at hand.
    free: Vec<f64>,
    /// Right-hand side without the forces of rows, N.
    rhs: Vec<f64>,
    solved: Solved,
}

/// Solution with a set of held rows.
#[derive(Debug)]
struct SetSolution {
    /// m/s, four numbers per node.
    velocity: Vec<f64>,
    /// Forces of the held rows, N.
    lambda: Vec<f64>,
    /// How many held rows it misses.
    missed: usize,
}

/// Result of the solves of a round so far.
#[derive(Debug, Default)]
struct Solved {
    outcome: Option<CoupledOutcome>,
    report: ContactReport,
    times: StageTimes,
}

impl Solved {
    fn is_solved(&self) -> bool {
        self.outcome.is_some_and(|outcome| outcome.parts[0].status.is_best_attainable())
    }

    fn finished(self) -> (CoupledOutcome, ContactReport, StageTimes) {
        (self.outcome.expect("every round solves"), self.report, self.times)
    }

    fn add(&mut self, (next, mut times, _): (CoupledOutcome, StageTimes, bool)) {
        let before = self.outcome.map_or(0, |outcome| outcome.parts[0].iterations);
        self.outcome = Some(next.after(before));
        self.report.solves += 1;
        self.times.append(&mut times);
    }
}

impl<'a> RowSolves<'a> {
    pub(crate) fn new(together: &'a CoupledSolver, form: CorrectionForm<'a>) -> RowSolves<'a> {
        RowSolves { together, form, upgraded: false, factor: None, contact: None }
    }

    /// Solves under the rows, without them until solids touch. The recording ends with the system of the round. A round of separation has an `aim`; where
    /// this is rough, it tries one set of rows, and none join.
    pub(crate) fn solve(
        &mut self,
        gpu: &Gpu,
        recorder: Recorder,
        aim: Option<Aim>,
        (rows_of, limits): (RowsOf, RowLimits),
    ) -> Result<(CoupledOutcome, ContactReport, StageTimes), Error> {
        let at = self.form.at;
        let system = &self.together.outer.system;
        let rough = aim.is_some_and(|aim| aim.tolerance > self.together.tolerance());
        let limits = if rough { RowLimits { meetings: 0, sets: 1 } } else { limits };
        let mut solved = Solved::default();
        let mut nodes = lock(system.nodes.as_ref().expect("made with every solver for contact"));
        let mut rows = Vec::new();
        let mut recorder = recorder;
        if self.contact.is_none() {
            let again = aim.is_some_and(|aim| aim.guess);
            solved.add(self.together.solve_form(gpu, recorder, &self.form, (again, None), aim, &mut |_| {})?);
            recorder = Recorder::new(gpu);
        } else if self.upgraded {
            self.factorise(gpu, recorder, &mut solved.times)?;
            recorder = Recorder::new(gpu);
        }
        let ([velocity, rhs], mut stages) = nodes.read(gpu, recorder, at.solids, at.fields)?;
        solved.times.append(&mut stages);
        if self.contact.is_none() {
            let found = rows_of(&contact_rows::three(&velocity), &[])?.filter(|_| solved.is_solved());
            let Some(found) = found else {
                return Ok(solved.finished());
            };
            rows = found;
            self.factorise(gpu, Recorder::timed(gpu), &mut solved.times)?;
        }
        let RowSolves { together, form, factor, contact, .. } = self;
        let schur = match &form.prepared {
            Some((schur, Prepared::Schur(inverse))) => Some((*schur, inverse)),
            _ => None,
        };
        let Some(factor) = schur.map(|(_, inverse)| &inverse.factor).or(factor.as_ref()) else {
            solved.report.unsettled = rows.len() as u32;
            let (mut outcome, report, times) = solved.finished();
            outcome.parts.iter_mut().for_each(|part| part.status = SolveStatus::Breakdown);
            return Ok((outcome, report, times));
        };
        let n_nodes = at.coupling.n_nodes;
        let mut free = velocity.clone();
        let later = contact.is_some();
        match contact {
            None => *contact = Some(Contact::new(rows, n_nodes, factor, &free, rough)),
            Some(contact) => {
                let without: Vec<f64> = contact.lambda.iter().map(|lambda| -lambda).collect();
                contact.system.add_velocity(&without, &mut free);
                contact.search.resume();
                if contact.rough
                    && !rough
                    && let Some(rows) = rows_of(&contact_rows::three(&free), &[])?
                {
                    contact.renew(rows, n_nodes, factor);
                }
            }
        }
        let contact = contact.as_mut().expect("set above");
        let aim = aim.map(|aim| Aim { guess: false, ..aim });
        let nodes = &mut *nodes;
        let mut round = Round { gpu, together, form, schur, factor, nodes, aim, free, rhs, solved };
        let mut velocity = velocity;
        for meeting in 0.. {
            velocity = round.iterate_active_set(contact, limits.sets, velocity)?;
            let next = rows_of(&contact_rows::three(&velocity), &contact.rows)?;
            let Some(next) = next.filter(|_| round.solved.is_solved() && meeting < limits.meetings) else {
                break;
            };
            *contact = Contact::new(next, n_nodes, factor, &round.free, rough);
            if later {
                contact.search.resume();
            }
        }
        if aim.is_some() {
            // The next round begins without forces of rows.
            at.solids.rhs.upload(gpu, &round.rhs);
            contact.pushed = plus(&round.rhs, 1.0, &contact.system.forces(&contact.lambda));
        }
        Ok(round.solved.finished())
    }

    /// Right-hand side of the solids with the forces of the rows, N; `None` where the device has it.
    pub(crate) fn pushed(self) -> Option<Vec<f64>> {
        self.contact.map(|contact| contact.pushed).filter(|pushed| !pushed.is_empty())
    }

    /// S^-1, in a form that needs it, after the recording. With rows the Schur-complement form is worth more wet nodes: in the other one a set of
    /// rows takes several solves. Its wet nodes are those of a round.
    fn factorise(&mut self, gpu: &Gpu, recorder: Recorder, times: &mut StageTimes) -> Result<(), Error> {
        let at = self.form.at;
        let system = &self.together.outer.system;
        self.upgraded |= matches!(self.form.prepared, Some((_, Prepared::Monolithic)));
        if let Some(schur) = system.schur.as_ref().filter(|_| self.upgraded) {
            let (prepared, mut stages) = system.prepare(gpu, recorder, at, (schur, schur.room()))?;
            times.append(&mut stages);
            self.form.prepared = Some((schur, prepared));
        }
        if !self.form.condenses() && self.factor.is_none() {
            let stiffness = system.stiffness.as_ref().expect("made with every solver for contact");
            self.factor = stiffness.read_and_factorise(gpu, at.solids, at.fields)?;
        }
        Ok(())
    }
}

impl Round<'_, '_> {
    /// Solves with one set of held rows after another, until no row is wrong, at the end with the best of them. Returns the last velocities, given
    /// those on the device.
    fn iterate_active_set(
        &mut self,
        contact: &mut Contact,
        sets: u32,
        mut velocity: Vec<f64>,
    ) -> Result<Vec<f64>, Error> {
        for _ in 0..sets {
            let Some(solved) = self.solve_set(contact)? else {
                self.solved.report.unsettled = contact.search.held().iter().filter(|held| **held).count() as u32;
                if self.solved.outcome.is_none() || contact.lambda.is_empty() {
                    let none = vec![false; contact.system.n()];
                    let none = contact.system.hold(&none).expect("no row depends on another");
                    let solved = self.hold(none, &self.rhs.clone())?;
                    (velocity, contact.lambda) = (solved.velocity, solved.lambda);
                }
                break;
            };
            velocity = solved.velocity;
            let sound = solved.missed == 0 && self.solved.is_solved();
            let (wrong, exchanged) = contact.search.exchange(&contact.system, &solved.lambda, &velocity, sound);
            self.solved.report.unsettled = (wrong + solved.missed) as u32;
            if !exchanged || !self.solved.is_solved() {
                break;
            }
        }
        if let Some(wrong) = contact.search.return_to_best()
            && let Some(solved) = self.solve_set(contact)?
        {
            velocity = solved.velocity;
            self.solved.report.unsettled = (wrong + solved.missed) as u32;
        }
        Ok(velocity)
    }

    /// Solves with the rows that the search holds; `None` where they are dependent to rounding.
    fn solve_set(&mut self, contact: &mut Contact) -> Result<Option<SetSolution>, Error> {
        let Contact { system, search, lambda, .. } = contact;
        let Some(held) = system.hold(search.held()) else {
            return Ok(None);
        };
        let pushed = match search.slipping_forces(system) {
            Some(forces) => plus(&self.rhs, 1.0, &forces),
            None => self.rhs.clone(),
        };
        let solved = self.hold(held, &pushed)?;
        lambda.clone_from(&solved.lambda);
        lambda.iter_mut().zip(search.slipping()).for_each(|(lambda, slipping)| *lambda += slipping);
        Ok(Some(solved))
    }

    /// Solves with held rows. `pushed`: right-hand side without their forces.
    fn hold(&mut self, held: HeldRows, pushed: &[f64]) -> Result<SetSolution, Error> {
        let at = self.form.at;
        if let Some((schur, inverse)) = self.schur {
            let start = contact_rows::prescribed(self.factor, &self.free);
            let held = HeldSolve::new(self.gpu, held, &start, pushed, &at.solids.rhs);
            schur.hold(self.gpu, inverse, &held);
            let velocity = self.solve(Some(&held))?;
            return Ok(SetSolution { velocity, lambda: held.lambda(), missed: 0 });
        }
        let tolerance = self.aim.map_or(self.together.tolerance(), |aim| aim.tolerance);
        let mut forces = ForceSearch::new(held, &self.free);
        loop {
            at.solids.rhs.upload(self.gpu, &plus(pushed, 1.0, &forces.forces()));
            let velocity = self.solve(None)?;
            if !self.solved.is_solved() || !forces.advance(&velocity, tolerance) {
                let missed = forces.violated(&velocity, tolerance);
                return Ok(SetSolution { velocity, lambda: forces.lambda().to_vec(), missed });
            }
        }
    }

    fn solve(&mut self, held: Option<&HeldSolve>) -> Result<Vec<f64>, Error> {
        let at = self.form.at;
        let (recorder, with) = (Recorder::timed(self.gpu), (true, held));
        self.solved.add(self.together.solve_form(self.gpu, recorder, self.form, with, self.aim, &mut |_| {})?);
        self.nodes.read_velocity(self.gpu, at.fields)
    }
}
