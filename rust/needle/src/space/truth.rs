//! Executions in 3D where the plan is wrong, as in the plane ([`crate::Truth`]).
//!
//! The believed execution is that of [`SpaceExecutor::rollout`], with the true curvature. A witness follows it in the
//! anatomy. What lies outside of the body counts from the moment on at which the tip is inside of it: the needle goes through
//! the air to a skin that is deeper than believed. The believed pose is that of the tip without the noise on the length up to
//! the coil, of which each turn is undone about its point.

use ppvi::space::voxel;
use ppvi::{Error, Result, StopFlag};
use rayon::prelude::*;

use crate::random::stream;
use crate::space::arc::{SpacePose, Vec3, along, carried};
use crate::space::execution::SpaceExecutor;
use crate::space::rollout::SpaceRun;
use crate::space::volume::{Volume, Way};
use crate::space::watch::Watch;
use crate::workspace::Event;

/// Points in a voxel of the way from the rim of the target to the point nearest to its centre.
const POINTS_IN_VOXEL: f64 = 4.0;

/// What is true in an execution and not as planned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceTruth {
    /// Rows of the rigid motion that takes a believed position to that in the anatomy: rotation, and shift, mm.
    pub rows: [[f64; 4]; 3],
    /// Curvature of the needle, relative to the planned one.
    pub curvature: f64,
    /// Length behind the tip, mm, whose tip noise the controller does not know yet.
    pub behind: f64,
}

/// A turn of the tip by noise.
struct Turn {
    at: Vec3,
    from: Vec3,
    to: Vec3,
    /// Length of the path before it, mm.
    length: f64,
}

impl SpaceTruth {
    /// Whether the anatomy is where the plan says.
    fn is_in_place(&self) -> bool {
        self.rows == [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    }

    #[inline]
    fn place(&self, [x, y, z]: Vec3) -> Vec3 {
        self.rows.map(|row| row[0] * x + row[1] * y + row[2] * z + row[3])
    }
}

/// Follows an execution in the anatomy.
struct Witness<'a> {
    truth: SpaceTruth,
    /// The anatomy in which the plan believes.
    volume: &'a Volume,
    /// The anatomy as it is.
    anatomy: &'a Volume,
    /// Believed centre of the target, mm.
    centre: Vec3,
    way: Way<'a>,
    /// The last two poses, and those that were believed.
    last: [[SpacePose; 2]; 2],
    /// Length of the path, mm, and its turns by noise.
    length: f64,
    turns: Vec<Turn>,
    is_inside: bool,
    event: Option<Event>,
}

impl<'a> Witness<'a> {
    fn new(truth: SpaceTruth, [volume, anatomy]: [&'a Volume; 2], centre: Vec3, start: SpacePose) -> Self {
        let place = truth.place(start.position);
        let (last, way) = ([[start; 2]; 2], anatomy.way(place));
        let (length, turns) = (0.0, vec![]);
        let mut witness =
            Witness { truth, volume, anatomy, centre, way, last, length, turns, is_inside: false, event: None };
        witness.sees(anatomy.code(place));
        witness
    }

    fn sees(&mut self, code: u8) {
        match code {
            voxel::OBSTACLE => self.event = Some(Event::Collision),
            voxel::OUTSIDE if self.is_inside => self.event = Some(Event::Exit),
            voxel::OUTSIDE => {}
            _ => self.is_inside = true,
        }
    }

    /// Goes straight on to a position in the plan.
    fn goes_to(&mut self, position: Vec3) {
        if self.event.is_some() {
            return;
        }
        let place = self.truth.place(position);
        let code = self.way.to(place);
        // The target ends no way, and what is behind it counts.
        let is_passed = code == voxel::TARGET || code == voxel::OUTSIDE && !self.is_inside;
        self.sees(if is_passed { self.anatomy.code(place) } else { code });
    }

    /// Whether the tip ends in the true target, after it has met the believed one: at the point of the believed target
    /// nearest to its centre, straight on.
    fn ends_in_target(&mut self) -> bool {
        let [[tip_before, before], [tip, SpacePose { position, tangent }]] = self.last;
        let (_, share) = self.volume.met(before.position, position);
        let at = |from: Vec3, to: Vec3| [0, 1, 2].map(|axis| from[axis] + share * (to[axis] - from[axis]));
        let (contact, mut end) = (at(before.position, position), at(tip_before.position, tip.position));
        let tip_contact = end;
        let apart = [0, 1, 2].map(|axis| self.centre[axis] - contact[axis]);
        let ahead = (0..3).map(|axis| apart[axis] * tangent[axis]).sum::<f64>().max(0.0);
        let size = self.volume.voxel_size().into_iter().fold(f64::INFINITY, f64::min);
        let count = (ahead * POINTS_IN_VOXEL / size).ceil();
        for number in 1..=count as u32 {
            let length = ahead * f64::from(number) / count;
            if self.volume.code(along(contact, length, tangent)) != voxel::TARGET {
                break;
            }
            end = along(tip_contact, length, tip.tangent);
            self.goes_to(end);
        }
        self.event.is_none() && self.anatomy.code(self.truth.place(end)) == voxel::TARGET
    }
}

impl Watch for Witness<'_> {
    fn passes(&mut self, pose: SpacePose) -> Vec3 {
        let [before, _] = self.last[1];
        self.length += distance(before.position, pose.position);
        let believed = self.believed(pose);
        self.last = [self.last[1], [pose, believed]];
        self.goes_to(pose.position);
        believed.position
    }

    fn turns(&mut self, SpacePose { position: at, tangent: from }: SpacePose, to: Vec3) {
        if self.is_late() {
            self.turns.push(Turn { at, from, to, length: self.length });
        }
    }

    fn believed(&self, pose: SpacePose) -> SpacePose {
        let late = self.turns.iter().rev().take_while(|turn| self.length - turn.length < self.truth.behind);
        late.fold(pose, |SpacePose { position, tangent }, Turn { at, from, to, .. }| {
            let apart = [0, 1, 2].map(|axis| position[axis] - at[axis]);
            SpacePose { position: along(*at, 1.0, carried(apart, *to, *from)), tangent: carried(tangent, *to, *from) }
        })
    }

    fn is_late(&self) -> bool {
        self.truth.behind > 0.0
    }

    fn curvature(&self, _: &Volume, position: Vec3) -> f64 {
        self.truth.curvature * self.anatomy.curvature(self.truth.place(position))
    }

    fn is_elsewhere(&self) -> bool {
        !(self.truth.is_in_place() && std::ptr::eq(self.volume, self.anatomy))
    }

    fn event(&self) -> Option<Event> {
        self.event
    }

    fn judged(&mut self, event: Event) -> Event {
        let is_believed = self.is_elsewhere() || self.is_late();
        if event != Event::Target || !is_believed || self.ends_in_target() {
            return event;
        }
        self.event.unwrap_or(Event::Exit)
    }
}

fn distance(from: Vec3, to: Vec3) -> f64 {
    (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum::<f64>().sqrt()
}

impl SpaceExecutor<'_> {
    /// Executes the policy once from each start, where the plan is wrong as its truth says, with the noise of run 0, 1, 2 ...
    /// of [`SpaceExecutor::rollout`]. `centre` is the believed centre of the target, mm; `anatomy` is the true anatomy if it is
    /// not that of the plan. An exit is also the end of a tip beside the target.
    ///
    /// # Errors
    /// As [`SpaceExecutor::rollout`], and [`Error::Length`] for another number of truths than of starts.
    pub fn rollout_in(
        &self,
        starts: &[SpacePose],
        truths: &[SpaceTruth],
        centre: Vec3,
        anatomy: Option<&Volume>,
        seed: u64,
    ) -> Result<Vec<SpaceRun>> {
        if truths.len() != starts.len() {
            return Err(Error::Length { name: "truths", expected: starts.len(), found: truths.len() });
        }
        let (stop, setup) = (StopFlag::current(), self.problem.setup());
        let volumes = [&setup.volume, anatomy.unwrap_or(&setup.volume)];
        let one = |(run, (start, truth)): (usize, (&SpacePose, &SpaceTruth))| {
            stop.check();
            let start = self.checked(*start)?;
            let mut witness = Witness::new(*truth, volumes, centre, start);
            Ok(self.run(start, setup.noise, &mut stream(seed, run as u64), &mut witness))
        };
        starts.par_iter().zip(truths).enumerate().with_min_len(16).map(one).collect()
    }
}
