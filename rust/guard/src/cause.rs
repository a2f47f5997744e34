//! Causes of stops and refusals, their severities and owners, and sets of causes as bit masks.

use core::ops::{BitAnd, BitOr, BitOrAssign, Sub};

/// Who ordered or caused a stop, a pause or a motion; an earlier owner has more authority than a later one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Owner {
    /// A person.
    Person,
    /// The robot.
    Robot,
    /// A sensor.
    Sensor,
    /// The program that steers the needle.
    Loop,
}

impl Owner {
    /// All owners, by their numbers.
    pub const ALL: [Owner; 4] = [Owner::Person, Owner::Robot, Owner::Sensor, Owner::Loop];
}

/// Effect of a cause on the operating state of the guard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// One command is refused; the state does not change.
    Refusal,
    /// The motion stops; the order RESUME continues the run when the cause is gone.
    Pause,
    /// The motion stops, and the cause is latched until a person resets the guard.
    Fault,
}

macro_rules! causes {
    ($($name:ident = $text:literal, $owner:ident, $severity:ident;)*) => {
        /// Cause of a stop or of a refusal; its number is the number of its bit in [`Causes`].
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Cause {
            $(#[doc = concat!("`", $text, "`")] $name,)*
        }

        impl Cause {
            /// All causes, by their numbers.
            pub const ALL: &[Cause] = &[$(Cause::$name,)*];

            /// The name of this cause in events and recordings.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Cause::$name => $text,)* }
            }

            /// Who causes it: the robot, a sensor or the loop; a person for `stop_ordered`.
            #[must_use]
            pub const fn owner(self) -> Owner {
                match self { $(Cause::$name => Owner::$owner,)* }
            }

            /// Effect of this cause on the operating state.
            #[must_use]
            pub const fn severity(self) -> Severity {
                match self { $(Cause::$name => Severity::$severity,)* }
            }
        }
    };
}

causes! {
    ForceStale = "force_stale", Sensor, Fault;
    ForceSuspect = "force_suspect", Sensor, Fault;
    ForceFault = "force_fault", Sensor, Fault;
    ForceExceeded = "force_exceeded", Sensor, Fault;
    ForceRising = "force_rising", Sensor, Fault;
    PoseStale = "pose_stale", Sensor, Pause;
    PoseSuspect = "pose_suspect", Sensor, Pause;
    PoseUnseen = "pose_unseen", Sensor, Pause;
    PoseJumped = "pose_jumped", Sensor, Fault;
    PoseFrozen = "pose_frozen", Sensor, Fault;
    PoseFault = "pose_fault", Sensor, Fault;
    TipUnknown = "tip_unknown", Sensor, Pause;
    OutOfPlane = "out_of_plane", Sensor, Fault;
    OutOfWorkspace = "out_of_workspace", Sensor, Fault;
    InObstacle = "in_obstacle", Sensor, Fault;
    DeadmanReleased = "deadman_released", Sensor, Pause;
    StageStale = "stage_stale", Robot, Fault;
    StageSuspect = "stage_suspect", Robot, Fault;
    StageFault = "stage_fault", Robot, Fault;
    StageJumped = "stage_jumped", Robot, Fault;
    DepthExceeded = "depth_exceeded", Robot, Fault;
    RollExceeded = "roll_exceeded", Robot, Fault;
    Overspeed = "overspeed", Robot, Fault;
    WrongWay = "wrong_way", Robot, Fault;
    NoMotion = "no_motion", Robot, Fault;
    StillMoving = "still_moving", Robot, Fault;
    LoopLate = "loop_late", Loop, Fault;
    ClockMismatch = "clock_mismatch", Loop, Fault;
    TimeExceeded = "time_exceeded", Loop, Fault;
    RecordingBehind = "recording_behind", Loop, Pause;
    RecordingLost = "recording_lost", Loop, Fault;
    GuardFailed = "guard_failed", Loop, Fault;
    PlanLost = "plan_lost", Loop, Pause;
    StopOrdered = "stop_ordered", Person, Fault;
    NotPossible = "not_possible", Loop, Refusal;
    NotAuthorized = "not_authorized", Loop, Refusal;
    NotEnabled = "not_enabled", Loop, Refusal;
    NotHomed = "not_homed", Loop, Refusal;
    NotReset = "not_reset", Loop, Refusal;
    NotFinite = "not_finite", Loop, Refusal;
    DepthBeyond = "depth_beyond", Robot, Refusal;
    VelocityBeyond = "velocity_beyond", Loop, Refusal;
    RollBeyond = "roll_beyond", Robot, Refusal;
    RotationBeyond = "rotation_beyond", Loop, Refusal;
    SecondCommander = "second_commander", Loop, Refusal;
    NotARetraction = "not_a_retraction", Loop, Refusal;
    LimitsInUse = "limits_in_use", Loop, Refusal;
}

/// A set of causes: bit `n` stands for the cause number `n`. Empty means healthy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(transparent)]
pub struct Causes(pub u64);

impl Causes {
    /// No cause.
    pub const NONE: Causes = Causes(0);
    /// All causes.
    pub const ALL: Causes = Causes((1 << Cause::ALL.len()) - 1);
    /// The causes that only refuse a command or an order.
    pub const REFUSALS: Causes = Causes::with_severity(Severity::Refusal);
    /// The causes that are faults.
    pub const FAULTS: Causes = Causes::with_severity(Severity::Fault);

    /// The set of these causes.
    #[must_use]
    pub const fn of(causes: &[Cause]) -> Causes {
        let (mut bits, mut index) = (0, 0);
        while index < causes.len() {
            bits |= 1 << causes[index] as u8;
            index += 1;
        }
        Causes(bits)
    }

    const fn with_severity(severity: Severity) -> Causes {
        let (mut bits, mut index) = (0, 0);
        while index < Cause::ALL.len() {
            if Cause::ALL[index].severity() as u8 == severity as u8 {
                bits |= 1 << index;
            }
            index += 1;
        }
        Causes(bits)
    }

    /// Whether the set is empty.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether the set contains a cause.
    #[must_use]
    pub const fn has(self, cause: Cause) -> bool {
        self.0 >> cause as u8 & 1 == 1
    }

    /// Whether both sets have a cause in common.
    #[must_use]
    pub const fn meets(self, other: Causes) -> bool {
        self.0 & other.0 != 0
    }

    /// The owner with the highest authority among those of the causes; None if the set is empty.
    #[must_use]
    pub fn first_owner(self) -> Option<Owner> {
        Cause::ALL.iter().filter(|cause| self.has(**cause)).map(|cause| cause.owner()).min()
    }
}

impl BitOr for Causes {
    type Output = Causes;
    fn bitor(self, other: Causes) -> Causes {
        Causes(self.0 | other.0)
    }
}

impl BitOrAssign for Causes {
    fn bitor_assign(&mut self, other: Causes) {
        self.0 |= other.0;
    }
}

impl BitAnd for Causes {
    type Output = Causes;
    fn bitand(self, other: Causes) -> Causes {
        Causes(self.0 & other.0)
    }
}

impl Sub for Causes {
    type Output = Causes;
    fn sub(self, other: Causes) -> Causes {
        Causes(self.0 & !other.0)
    }
}

impl From<Cause> for Causes {
    fn from(cause: Cause) -> Causes {
        Causes::of(&[cause])
    }
}
