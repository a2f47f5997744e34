//! Program, network and robot around the guard and the supervisor of the crate, in slots of 5 ms.

use needleplan_guard::advance::{ordered, validated};
use needleplan_guard::cause::{Causes, Owner};
use needleplan_guard::datagram::{Kind, LONGEST};
use needleplan_guard::session::Message;
use needleplan_guard::state::{Motion, Operating, Order, Report, State, Transition};

use crate::axis::{Axis, WATCHDOG, after};
use crate::events::{Event, Fate, Fault, Mutant, Schedule};
use crate::robot::bench::{Bench, MS};

/// A slot of time, in which each side receives, decides and sends once.
const SLOT: i64 = 5 * MS;
/// Slots of a schedule, and slots within which a needle that must stand stands: a lost STOP is sent again after 20 ms.
pub const SLOTS: i64 = 40;
const BOUND: i64 = 9;
/// Slots for which a command is sent again, and slots of a standstill that counts as rest.
const VALID: i64 = 6;
const REST: i64 = 11;
/// Slots until the silence of the loop is noticed.
const LOOP_LATE: i64 = 10;
/// Slots by which a datagram may come later than the others.
pub const LATEST: i64 = 5;

/// The program beside the supervisor: its guard, its command that waits, and its repeated STOP.
struct Program {
    state: State,
    trips: u32,
    causes: Causes,
    waiting: Option<(u32, f64, i64, u64)>,
    stop_number: u32,
    stopped: i64,
    last_mm: f64,
    still: i64,
    wants_mm: Option<f64>,
    order_at: Option<i64>,
    hang_at: Option<i64>,
    hangs: bool,
}

pub struct World {
    is_dead: bool,
    bench: Bench,
    axis: Axis,
    program: Program,
    to_robot: Vec<(i64, Vec<u8>)>,
    from_robot: Vec<(i64, Vec<u8>)>,
    counts: [usize; 2],
    faults: Vec<Fault>,
    first: i64,
    now: i64,
    mutant: Option<Mutant>,
    /// Slot by which the needle must stand, since a stop was decided and no later motion was sent.
    must_stand: Option<i64>,
    /// Slot since which the needle must go out: that of a person's retraction.
    must_go_out: Option<i64>,
    /// Slot of the last motion that was sent, unless a stop was decided since.
    moving_since: Option<i64>,
    /// Whether the program was enabled while the needle moved.
    is_hasty: bool,
}

impl World {
    pub fn new(schedule: &Schedule, mutant: Option<Mutant>) -> World {
        let mut bench = Bench::counted(schedule.counted);
        bench.rules.force_age_s = f64::INFINITY;
        bench.rules.pose_age_s = f64::INFINITY;
        bench.post.state.is_homed = true;
        let state = bench.post.state;
        let axis = Axis {
            depth_mm: 10.0,
            target_mm: 60.0,
            speed_mm: 0.05,
            sequence: schedule.counted,
            number: schedule.counted,
            heard: 0,
            moved: 0,
        };
        let program = Program {
            state,
            trips: 0,
            causes: Causes::NONE,
            waiting: None,
            stop_number: schedule.counted,
            stopped: -100,
            last_mm: 10.0,
            still: 0,
            wants_mm: None,
            order_at: None,
            hang_at: None,
            hangs: false,
        };
        World {
            is_dead: false,
            bench,
            axis,
            program,
            to_robot: Vec::new(),
            from_robot: Vec::new(),
            counts: [0; 2],
            faults: schedule.faults.clone(),
            first: schedule.events[0].0,
            now: 0,
            mutant,
            must_stand: None,
            must_go_out: None,
            moving_since: None,
            is_hasty: false,
        }
    }

    /// Put a datagram on its way; it arrives in the next slot, unless it is the one with a fault.
    fn put(&mut self, is_to_robot: bool, datagram: Vec<u8>) {
        let count = &mut self.counts[usize::from(is_to_robot)];
        let number = *count;
        if self.now >= self.first {
            *count += 1;
        }
        let queue = if is_to_robot { &mut self.to_robot } else { &mut self.from_robot };
        let usual = self.now + 1;
        let has_begun = self.now >= self.first;
        match self.faults.iter().find(|(way, at, _)| has_begun && (*way, *at) == (is_to_robot, number)) {
            Some((.., Fate::Lost)) => (),
            Some((.., Fate::Again(slots))) => queue.extend([(usual, datagram.clone()), (usual + slots, datagram)]),
            Some((.., Fate::Late(slots))) => queue.push((usual + slots, datagram)),
            None => queue.push((usual, datagram)),
        }
    }

    fn command(&mut self, kind: Kind, number: u32, deadline_ns: u64, target_mm: f64) -> bool {
        let mut bytes = [0; LONGEST];
        let now_ns = self.bench.now_ns;
        let supervisor = &mut self.bench.supervisor;
        let size = if self.mutant == Some(Mutant::PassesAll) {
            supervisor.session.encode(kind, number, deadline_ns, (target_mm, 10.0), now_ns, &mut bytes)
        } else {
            supervisor.command(kind, number, deadline_ns, (target_mm, 10.0), now_ns, &mut bytes)
        };
        if size > 0 {
            self.put(true, bytes[..size].to_vec());
        }
        size > 0
    }

    fn send_stop(&mut self) {
        let number = self.bench.supervisor.session.next_number();
        self.program.stop_number = number;
        self.program.stopped = self.now;
        self.program.still = 0;
        self.command(Kind::Stop, number, 0, 0.0);
    }

    fn stand_by(&mut self, slot: i64) {
        self.must_stand = Some(self.must_stand.map_or(slot, |before| before.min(slot)));
    }

    fn note_stop(&mut self) {
        self.stand_by(self.now + BOUND);
        (self.must_go_out, self.moving_since) = (None, None);
    }

    /// Send a motion, and again until the robot has accepted it, as a thread of the program does.
    fn begin(&mut self, target_mm: f64) {
        let number = self.bench.supervisor.session.next_number();
        let deadline_ns = (self.bench.now_ns + VALID * SLOT) as u64;
        if self.command(Kind::Insert, number, deadline_ns, target_mm) {
            self.program.waiting = Some((number, target_mm, self.now + VALID, deadline_ns));
            self.must_stand = None;
            self.must_go_out = (target_mm < self.axis.depth_mm).then_some(self.now);
            self.moving_since = Some(self.now);
        }
    }

    fn follow(&mut self, step: Transition, is_of_a_person: bool) {
        let is_new = self.program.state.operating != Operating::Enabled && step.state.operating == Operating::Enabled;
        self.is_hasty |= is_new && self.axis.is_moving();
        self.program.state = step.state;
        if step.stops {
            self.note_stop();
            self.send_stop();
        }
        self.post(is_of_a_person);
        match step.motion {
            Some(Motion::Move) => self.begin(self.program.wants_mm.unwrap_or(60.0)),
            Some(Motion::Retract) => self.begin(0.0),
            None => (),
        }
    }

    fn post(&mut self, is_of_a_person: bool) {
        self.bench.post.state = self.program.state;
        self.bench.post.trips = (!is_of_a_person).then_some(self.program.trips);
        self.bench.posts();
    }

    fn order(&mut self, order: Order, owner: Owner) {
        let step = ordered(self.program.state, order, owner, self.bench.now_ns);
        if !step.is_refused {
            self.follow(step, order == Order::Retract);
        }
    }

    fn happen(&mut self, event: Event) {
        if self.program.hangs {
            return;
        }
        match event {
            Event::Ordered(order, owner) => self.order(order, owner),
            Event::EarlyStop => {
                self.note_stop();
                self.send_stop();
                self.program.order_at = Some(self.now + 2);
            }
            Event::Restart => {
                self.program.causes = Causes::NONE;
                self.order(Order::Reset, Owner::Person);
                let begin =
                    if self.program.state.operating == Operating::Paused { Order::Resume } else { Order::Enable };
                self.order(begin, Owner::Person);
                self.program.wants_mm = Some(60.0);
            }
            Event::Begins(cause) => self.program.causes |= cause.into(),
            Event::Moves => {
                self.program.wants_mm = Some(55.0);
                self.order(Order::Move, Owner::Loop);
                self.program.wants_mm = None;
            }
            Event::Hangs => self.hang(LOOP_LATE + BOUND),
            Event::Dies => {
                self.is_dead = true;
                // Only the watchdog acts from now on, also if a stop was lost; a heartbeat may be late.
                self.must_stand = None;
                self.hang(WATCHDOG + LATEST + 2);
            }
            Event::LastStop => {
                self.note_stop();
                self.send_stop();
                self.program.hang_at = Some(self.now + 1);
            }
        }
    }

    fn hang(&mut self, noticed_after: i64) {
        self.program.hangs = true;
        self.stand_by(self.now + noticed_after);
        (self.must_go_out, self.moving_since) = (None, None);
    }

    fn validate(&mut self) {
        let trip = self.bench.supervisor.trip();
        let mut causes = self.program.causes | self.bench.supervisor.of_stage(0.03, self.bench.now_ns);
        if trip.count != self.program.trips {
            causes |= trip.causes;
            self.program.trips = trip.count;
        }
        let rests = self.program.still >= REST && self.program.waiting.is_none();
        let is_resting = rests || self.mutant == Some(Mutant::RestsAtOnce);
        let is_retracting = self.program.state.is_retracting();
        let report = Report { causes, is_busy: false, is_retracting, is_resting };
        self.follow(validated(self.program.state, report, self.bench.now_ns), false);
        if self.program.state.is_stopping && self.program.still == 0 && self.now - self.program.stopped >= 4 {
            if self.mutant == Some(Mutant::NoRepetition) {
                return self.bench.supervisor.tick(self.bench.now_ns);
            }
            self.send_stop();
        }
        if self.program.state.operating == Operating::Enabled && self.program.wants_mm.is_some() {
            self.order(Order::Move, Owner::Loop);
            self.program.wants_mm = None;
        }
        self.bench.supervisor.tick(self.bench.now_ns);
    }

    fn resend(&mut self) {
        let Some((number, target_mm, until, deadline_ns)) = self.program.waiting else { return };
        if self.now > until || !self.command(Kind::Insert, number, deadline_ns, target_mm) {
            self.program.waiting = None;
        }
    }

    fn hear(&mut self) {
        let now = self.now;
        let due: Vec<_> = self.from_robot.extract_if(.., |(at, _)| *at <= now).collect();
        for (_, datagram) in due {
            let Message::Status(status, _) = self.bench.supervisor.take(&datagram, self.bench.now_ns) else { continue };
            let program = &mut self.program;
            if program.waiting.is_some_and(|(number, ..)| !after(number, status.head.number)) {
                program.waiting = None;
            }
            let is_still =
                (status.depth_mm - program.last_mm).abs() <= 0.01 && !after(program.stop_number, status.head.number);
            program.still = if is_still { program.still + 1 } else { 0 };
            program.last_mm = status.depth_mm;
        }
    }

    pub fn slot(&mut self, events: &[(i64, Event)]) -> Option<&'static str> {
        self.now += 1;
        self.bench.now_ns += SLOT;
        let (now, now_ns) = (self.now, self.bench.now_ns);
        let due: Vec<_> = self.to_robot.extract_if(.., |(at, _)| *at <= now).collect();
        for (_, datagram) in due {
            self.axis.receive(&datagram, now, now_ns, self.mutant);
        }
        self.axis.tick(now, self.mutant);
        let stands = now - self.axis.moved >= REST - 1;
        let robot = &mut self.bench.robot;
        (robot.depth_mm, robot.number) = (self.axis.depth_mm, self.axis.number);
        robot.flags = u8::from(self.axis.is_moving()) | 2 | if stands { 4 } else { 0 };
        let datagram = robot.status(now_ns);
        self.put(false, datagram);
        self.hear();
        for (at, event) in events {
            if *at == now {
                self.happen(*event);
            }
        }
        if !self.program.hangs {
            if self.program.order_at.take_if(|at| *at == now).is_some() {
                self.order(Order::Stop, Owner::Person);
            }
            self.validate();
            self.resend();
            if self.program.hang_at == Some(now) {
                self.hang(LOOP_LATE + BOUND);
            }
        } else if self.mutant == Some(Mutant::NeverLate) {
            self.bench.supervisor.tick(now_ns);
        }
        let trips = self.bench.supervisor.trip().count;
        let mut bytes = [0; LONGEST];
        while !self.is_dead {
            let size = self.bench.supervisor.act(now_ns, &mut bytes);
            if size == 0 {
                break;
            }
            let repeats = bytes[5] == Kind::Stop as u8 && self.bench.supervisor.trip().count == trips;
            if repeats && self.mutant == Some(Mutant::NoRepetition) {
                continue;
            }
            self.put(true, bytes[..size].to_vec());
        }
        if self.bench.supervisor.trip().count != trips {
            self.note_stop();
        }
        self.mistake()
    }

    fn mistake(&self) -> Option<&'static str> {
        let axis = &self.axis;
        if self.must_stand.is_some_and(|slot| self.now > slot) && axis.is_moving() {
            return Some("it moves although it must stand");
        }
        if self.must_go_out.is_some_and(|since| self.now - since > BOUND) && axis.speed_mm >= 0.0 {
            return Some("it is not pulled out although a person has ordered it");
        }
        if self.moving_since.is_some_and(|since| self.now - since > BOUND) && !axis.is_moving() {
            return Some("an old stop has hit a new command");
        }
        self.is_hasty.then_some("it is enabled before it rests")
    }
}
