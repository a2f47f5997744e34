//! Executions in the continuous model with noise of the tangent.

use ppvi::space::{SUCCESS_STEPS, SpaceView, voxel};
use ppvi::{Error, Result};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::random::normal_pair;
use crate::space::arc::{SpaceArc, SpacePose, Vec3, along, bevel, blend, carried, turned, unit};
use crate::space::problem::{DISTURBED_AT, SpaceProblem};
use crate::space::watch::Watch;
use crate::workspace::Event;

/// Part of a unit tangent along the axis below which the tip is lost.
const LEAST_AHEAD: f64 = 0.05;

/// Largest length of the last piece of a step with noise, relative to that of the others.
const LAST_PIECE: f64 = 1.5;

/// Executes the policy of solved tables.
#[derive(Debug, Clone, Copy)]
pub struct SpaceExecutor<'a> {
    pub(crate) problem: &'a SpaceProblem,
    pub(crate) tables: SpaceView<'a>,
}

/// The tip in the continuous model: its pose, and the unit vector across it to which it bends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tip {
    pub pose: SpacePose,
    pub normal: Vec3,
}

impl Tip {
    /// The tip after its tangent has turned to a unit vector.
    fn turned_to(self, tangent: Vec3) -> Tip {
        let normal = carried(self.normal, self.pose.tangent, tangent);
        Tip { pose: SpacePose { tangent, ..self.pose }, normal }
    }

    /// The tip after its tangent has turned as from one unit vector to another.
    pub(crate) fn turned(self, from: Vec3, to: Vec3) -> Tip {
        let pose = SpacePose { tangent: carried(self.pose.tangent, from, to), ..self.pose };
        Tip { pose, normal: carried(self.normal, from, to) }
    }
}

/// A part of a step in the continuous model.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Followed {
    /// What the path meets first before its end.
    pub event: Option<Event>,
    /// The tip at the end, whatever the path has met.
    pub tip: Tip,
    /// Length, mm.
    pub length: f64,
}

/// A step from a pose: the planes at which the plan disturbs it and at its end, mm along the axis, and the share of the
/// curvature.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Course {
    pub from: Tip,
    pub planes: [f64; 2],
    pub share: f64,
}

/// The end of a step with noise.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepEnd {
    pub event: Option<Event>,
    pub pose: SpacePose,
    /// Inserted length, mm.
    pub length: f64,
}

fn event(code: u8) -> Option<Event> {
    match code {
        voxel::TARGET => Some(Event::Target),
        voxel::OBSTACLE => Some(Event::Collision),
        voxel::OUTSIDE => Some(Event::Exit),
        _ => None,
    }
}

impl<'a> SpaceExecutor<'a> {
    /// Takes a problem and its tables.
    ///
    /// # Errors
    /// [`Error::Length`] for tables of another size.
    pub fn new(problem: &'a SpaceProblem, tables: impl Into<SpaceView<'a>>) -> Result<Self> {
        let tables = tables.into();
        let expected = problem.mdp().shape().states();
        let lengths =
            [("values", tables.values.len()), ("policy", tables.policy.len()), ("success", tables.success.len())];
        match lengths.into_iter().find(|(_, found)| *found != expected) {
            Some((name, found)) => Err(Error::Length { name, expected, found }),
            None => Ok(SpaceExecutor { problem, tables }),
        }
    }

    /// Checks that a pose is in the volume and in the cone; its tangent gets the length one.
    pub(crate) fn checked(&self, pose: SpacePose) -> Result<SpacePose> {
        let pose = SpacePose { tangent: unit(pose.tangent), ..pose };
        let finite = pose.tangent.iter().all(|x| x.is_finite());
        if !finite
            || self.problem.setup().volume.index(pose.position).is_none()
            || !self.problem.directions().contains(pose.tangent)
        {
            let rule = "must be finite, in the volume, with a tangent in the cone";
            return Err(Error::parameter("pose", format!("{pose:?}"), rule));
        }
        Ok(pose)
    }

    /// Event at a pose: that of its voxel, or the exit from the cone.
    pub(crate) fn event_at(&self, pose: &SpacePose) -> Option<Event> {
        let cone = || (!self.problem.directions().contains(pose.tangent)).then_some(Event::Exit);
        event(self.problem.setup().volume.code(pose.position)).or_else(cone)
    }

    pub(crate) fn failure_cost(&self, event: Event) -> f64 {
        let costs = &self.problem.setup().costs;
        match event {
            Event::Collision => costs.collision,
            Event::Exit => costs.exit,
            Event::Target => 0.0,
        }
    }

    /// The step of an action from a pose: to the plane `advance` slices beyond the one that it has reached.
    pub(crate) fn course(&self, pose: SpacePose, action: usize) -> Course {
        let setup = self.problem.setup();
        let (roll, share) = setup.motion(action);
        let (x, spacing) = (pose.position[0], setup.volume.spacing()[0]);
        let end = ((x / spacing + 1e-6).floor() + setup.advance as f64) * spacing;
        Course {
            from: Tip { pose, normal: bevel(pose.tangent, roll) },
            planes: [x + DISTURBED_AT * (end - x), end],
            share,
        }
    }

    /// What a part of a step meets first, or at its end.
    pub(crate) fn met(&self, part: &Followed) -> Option<Event> {
        part.event.or_else(|| event(self.problem.setup().volume.code(part.tip.pose.position)))
    }

    /// Moves without noise to a plane; None if the path turns back before. It is cut into as many chords
    /// as a path of the plan, whose voxels are tested for events.
    pub(crate) fn follow(&self, tip: Tip, plane: f64, share: f64) -> Option<Followed> {
        self.followed::<true>(tip, plane, share)
    }

    /// The same without a test for events.
    pub(crate) fn follow_untested(&self, tip: Tip, plane: f64, share: f64) -> Option<Followed> {
        self.followed::<false>(tip, plane, share)
    }

    fn followed<const TESTED: bool>(&self, tip: Tip, plane: f64, share: f64) -> Option<Followed> {
        let volume = &self.problem.setup().volume;
        let open = self.problem.open_around(tip.pose.position);
        let is_uniform = volume.tissues().is_empty();
        if open == 0.0 && !is_uniform {
            return self.followed_through_tissues::<TESTED>(tip, plane, share, open);
        }
        let curvature = volume.curvature(tip.pose.position) * share;
        let arc = SpaceArc { start: tip.pose, normal: tip.normal, curvature };
        let length = arc.length_to(plane - tip.pose.position[0]);
        match length {
            // In one piece where nothing is met or asked for.
            Some(length) if length < open || (is_uniform && !TESTED) => {
                let mut tip = Piece::new(curvature, length).after(tip);
                tip.pose.position[0] = plane;
                Some(Followed { event: None, tip, length })
            }
            _ if is_uniform => Some(self.followed_in_pieces(tip, plane, Piece::new(curvature, length?), open)),
            _ => self.followed_through_tissues::<TESTED>(tip, plane, share, open),
        }
    }

    /// The same in pieces, of which those within `open` mm meet nothing.
    fn followed_in_pieces(&self, mut tip: Tip, plane: f64, whole: Piece, open: f64) -> Followed {
        let setup = self.problem.setup();
        let samples = setup.samples();
        let piece = Piece::new(whole.curvature, whole.length / samples as f64);
        let (mut met, mut way) = (None, setup.volume.way(tip.pose.position));
        for number in 1..=samples {
            tip = piece.after(tip);
            if number == samples {
                tip.pose.position[0] = plane;
            }
            if piece.length * (number as f64) < open {
                way.pass(tip.pose.position);
            } else {
                met = met.or_else(|| event(way.to(tip.pose.position)));
            }
        }
        Followed { event: met, tip, length: whole.length }
    }

    /// The same where the curvature varies: in pieces as long, each with the curvature at
    /// its start.
    fn followed_through_tissues<const TESTED: bool>(
        &self,
        mut tip: Tip,
        plane: f64,
        share: f64,
        open: f64,
    ) -> Option<Followed> {
        let setup = self.problem.setup();
        let samples = setup.samples();
        let longest = (plane - tip.pose.position[0]) / tip.pose.tangent[0] / samples as f64;
        let (mut piece, mut length, mut met) = (Piece::new(-1.0, longest), 0.0, None);
        let (mut bend, mut way) = (setup.volume.curvature(tip.pose.position), setup.volume.way(tip.pose.position));
        for _ in 0..8 * samples {
            let curvature = bend * share;
            // A path that bends away takes more than one further piece to the plane while this is more than two ahead.
            let left = if plane - tip.pose.position[0] < 2.0 * longest {
                let arc = SpaceArc { start: tip.pose, normal: tip.normal, curvature };
                arc.length_to(plane - tip.pose.position[0])
            } else {
                None
            };
            let is_last = left.is_some_and(|left| left <= longest);
            if is_last || curvature != piece.curvature {
                piece = Piece::new(curvature, left.filter(|_| is_last).unwrap_or(longest));
            }
            tip = piece.after(tip);
            length += piece.length;
            if is_last {
                tip.pose.position[0] = plane;
            }
            if length < open {
                way.pass(tip.pose.position);
            } else {
                bend = setup.volume.curvature(tip.pose.position);
                met = met.or_else(|| if TESTED { event(way.to(tip.pose.position)) } else { None });
            }
            if is_last {
                return Some(Followed { event: met, tip, length });
            }
            if tip.pose.tangent[0] <= 0.0 {
                return None;
            }
        }
        None
    }

    /// Makes a step with noise all along.
    pub(crate) fn disturbed_step(&self, course: Course, random: &mut Xoshiro256PlusPlus) -> StepEnd {
        self.step(course, self.problem.setup().noise, random, &mut ())
    }

    /// Makes a step with noise, rad after 1 mm, which turns the tip in the middle of each piece. `watch` sees the poses in
    /// the middle, before the noise, and at the end of each piece, and says how strongly the needle bends.
    pub(crate) fn step(
        &self,
        course: Course,
        noise: f64,
        random: &mut Xoshiro256PlusPlus,
        watch: &mut impl Watch,
    ) -> StepEnd {
        let setup = self.problem.setup();
        let Course { from: mut tip, planes: [_, plane], share } = course;
        let pieces = 2 * setup.samples();
        let longest = (plane - tip.pose.position[0]) / tip.pose.tangent[0] / pieces as f64;
        let seen = watch.believed(tip.pose).position;
        // What is believed may move while the tip does not.
        let open = if watch.is_late() { 0.0 } else { self.problem.open_around(seen) };
        let (mut piece, mut length) = (Piece::new(-1.0, longest), 0.0);
        let mut bend = watch.curvature(&setup.volume, tip.pose.position);
        let mut way = setup.volume.way(seen);
        let mut meets = |at: Vec3, length: f64| {
            if length < open {
                way.pass(at);
                None
            } else {
                event(way.to(at))
            }
        };
        for _ in 0..8 * pieces {
            let curvature = bend * share;
            let to_plane = |tip: Tip| {
                let arc = SpaceArc { start: tip.pose, normal: tip.normal, curvature };
                arc.length_to(plane - tip.pose.position[0])
            };
            // A last piece that is longer than others, since a disturbed tip may advance further than it would have.
            let last = LAST_PIECE * longest;
            let is_near = plane - tip.pose.position[0] <= last;
            let left = if is_near { to_plane(tip).filter(|left| *left <= last) } else { None };
            if left.is_some() || curvature != piece.curvature {
                piece = Piece::new(curvature, 0.5 * left.unwrap_or(longest));
            }
            tip = piece.after(tip);
            length += piece.length;
            let seen = watch.passes(tip.pose);
            let met = meets(seen, length);
            if met.is_some() {
                return StepEnd { event: met, pose: tip.pose, length };
            }
            let before = tip.pose;
            tip = tip.turned_to(disturbed(before.tangent, noise * (2.0 * piece.length).sqrt(), random));
            watch.turns(before, tip.pose.tangent);
            let rest = match left {
                Some(_) => Piece::new(curvature, to_plane(tip).unwrap_or(piece.length)),
                None => piece,
            };
            tip = rest.after(tip);
            length += rest.length;
            if left.is_some() {
                tip.pose.position[0] = plane;
            }
            let seen = watch.passes(tip.pose);
            let met = meets(seen, length);
            if length >= open || watch.is_elsewhere() {
                bend = watch.curvature(&setup.volume, tip.pose.position);
            }
            if met.is_some() || left.is_some() {
                return StepEnd { event: met, pose: tip.pose, length };
            }
            if tip.pose.tangent[0] <= LEAST_AHEAD {
                break;
            }
        }
        StepEnd { event: Some(Event::Exit), pose: tip.pose, length }
    }

    /// Price of a mm at a position.
    pub(crate) fn price(&self, position: Vec3) -> f64 {
        let setup = self.problem.setup();
        let index = setup.volume.index(position).filter(|_| !setup.prices.is_empty());
        index.map_or(0.0, |index| f64::from(setup.prices[index]))
    }

    /// Stored success of a state.
    #[inline]
    pub(crate) fn success_of(&self, state: usize) -> f64 {
        f64::from(self.tables.success[state]) / f64::from(SUCCESS_STEPS)
    }
}

/// An arc of a fixed length, whose sine and cosine are computed once.
#[derive(Debug, Clone, Copy)]
struct Piece {
    curvature: f64,
    length: f64,
    turn: [f64; 2],
    /// Way along the tangent and along the normal, mm.
    way: [f64; 2],
}

impl Piece {
    fn new(curvature: f64, length: f64) -> Piece {
        let (half_sin, half_cos) = (0.5 * curvature * length).sin_cos();
        let chord = if curvature.abs() * length > 1e-9 { 2.0 * half_sin / curvature } else { length };
        let turn = [2.0 * half_sin * half_cos, 1.0 - 2.0 * half_sin * half_sin];
        Piece { curvature, length, turn, way: [chord * half_cos, chord * half_sin] }
    }

    #[inline]
    fn after(&self, Tip { pose: SpacePose { position, tangent }, normal }: Tip) -> Tip {
        let ([sin, cos], [ahead, aside]) = (self.turn, self.way);
        let pose = SpacePose {
            position: along(along(position, ahead, tangent), aside, normal),
            tangent: blend(cos, tangent, sin, normal),
        };
        Tip { pose, normal: blend(-sin, tangent, cos, normal) }
    }
}

/// A tangent turned by two independent normal angles across it, each with this standard deviation, rad.
fn disturbed(tangent: Vec3, sigma: f64, random: &mut Xoshiro256PlusPlus) -> Vec3 {
    if sigma == 0.0 {
        return tangent;
    }
    turned(tangent, normal_pair(random).map(|x| x * sigma))
}
