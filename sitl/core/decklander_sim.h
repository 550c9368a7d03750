/* The interface of the library that simulates. Python's side is made from this file, as decklander.h says.
 *
 * A process of the first order is carried on by x = keep x + fresh n, with a standard normal n each step. */
#ifndef DECKLANDER_SIM_H
#define DECKLANDER_SIM_H

#include <stdbool.h>
#include <stdint.h>

/* The digest of this file. */
uint32_t dl_digest(void);

/* ---- video/: the AR.Drone 1.0's pictures ---- */

/* How to code a picture. */
typedef struct {
    int64_t width, height; /* Size, px. */
    int64_t quantizer;     /* Step of the quantization: 1 (fine) to 30; 31 stands for 2. */
    int64_t number;        /* The sender's count of pictures. */
} dl_sim_uvlc_picture;

/* In place of a length: the format cannot hold the picture. */
enum { DL_NOT_CODED = -1 };

/* Encode (height, width, 3) bytes as one picture. Return its length in bytes, 0 if it is longer than the room, or DL_NOT_CODED.
 * `bytes` is the size of `bgr`. */
int32_t dl_sim_uvlc_encode(const uint8_t *bgr, int32_t bytes, const dl_sim_uvlc_picture *picture, uint8_t *out, int32_t room);

/* ---- physics/: vehicle, air, contacts, sensors, vessel ---- */

/* Where the standard normal numbers lie that the sensors take at a step, and how many they are. */
enum dl_sim_noise {
    DL_IMU_NOISE = 0, DL_FIELD_NOISE = 6, DL_PRESSURE_NOISE = 9, DL_HEADING_DRIFT = 10, DL_PRESSURE_DRIFT = 11, DL_ECHO_NOISE = 12,
    DL_SENSOR_NOISE = 13,
};

/* What a simulated vehicle is doing. */
enum dl_sim_phase {
    DL_PHASE_LANDED, DL_PHASE_TAKING_OFF, DL_PHASE_HOVERING, DL_PHASE_FLYING, DL_PHASE_LANDING, DL_PHASE_EMERGENCY,
};

/* What a vehicle has touched. */
enum dl_sim_touched {
    DL_TOUCHED_NOTHING, DL_TOUCHED_DECK, DL_TOUCHED_SEA,
};

enum {
    /* The largest number of rotors of a simulated vehicle. */
    DL_ROTORS_MAX = 6,
    /* The largest number of single gusts in the simulated air. */
    DL_GUSTS_MAX = 100,
    /* The largest number of steps of physics that a stick command may be under way. */
    DL_COMMANDS_MAX = 1024,
    /* The largest number of ultrasound echoes under way to the telemetry. */
    DL_ECHOES_MAX = 64,
    /* Standard normal numbers that a vehicle takes at a step: gust (3), optical flow (2), tilt (2); the air takes as many. */
    DL_FLIGHT_NOISE = 7,
    /* Standard normal numbers of its disturbing effects: downwash (3), climb rate and turn rates by which the loops fly (1, 3). */
    DL_EFFECT_NOISE = 7,
};

/* The pad on a deck, in ned. */
typedef struct {
    double p[3]; /* Its centre, m. */
    double v[3]; /* Its velocity, m/s. */
    double R[9]; /* R_ned_pad. */
    double w[3]; /* Its turn rate, rad/s. */
} dl_sim_deck;

/* A single gust. */
typedef struct {
    double at_s;   /* When it begins, s. */
    double rise_s; /* Time of its rise, and of its fall, s. */
    double hold_s; /* Time at its height, s. */
    double v[2];   /* Velocity at its height, north and east, m/s. */
} dl_sim_gust;

/* The air over a ship. */
typedef struct {
    bool on;                        /* The air is more than a uniform wind. */
    bool logarithmic;               /* The wind grows with height. */
    bool dryden, kaimal;            /* Its turbulence is Dryden's, or Kaimal's. */
    bool wake, hull_wake;           /* Superstructure and hull leave a wake. */
    int64_t gusts;                  /* Number of single gusts. */
    double speed_m_s;               /* Mean speed 10 m over the water, m/s. */
    double along[2];                /* Unit direction that it blows to, north and east. */
    double roughness_m;             /* Roughness length of the water, m. */
    double log10m;                  /* Logarithm of 10 m over it. */
    double keep_ship;               /* Share by which the mean of the ship's velocity follows the deck's in a step. */
    double block_m[2];              /* The superstructure's middle from the pad, forward and starboard, m. */
    double block_size[3];           /* Its length, width and height, m. */
    double wake_decay;              /* Decay of its wake with distance. */
    double pad_yaw[2];              /* Cosine and sine of the pad's heading on the ship. */
    double deck_m[4];               /* The deck's edges from the pad: fore, aft, starboard, port, m. */
    double edge_m;                  /* Height of the edge that sheds the hull's wake, m. */
    double edge_decay;              /* Decay of that wake with distance. */
    dl_sim_gust gust[DL_GUSTS_MAX]; /* The single gusts. */
} dl_sim_air_params;

/* Effects that are off unless `on`; loop_mass_kg, tilt_gain and lift_share hold always. */
typedef struct {
    bool on;               /* Any of these effects is there. */
    bool saturates;        /* Rotors saturate one by one. */
    bool moving_deck;      /* The ground effect lags over a deck that moves. */
    bool rotor_drag;       /* Drag goes with the rotors' speed. */
    double sag;            /* Share of the battery's voltage that full thrust takes. */
    double hover_share;    /* Share of full thrust that hovering takes. */
    double drag_per_m;     /* Quadratic drag, 1/m. */
    double downwash;       /* Strength of the downwash that the deck throws back, m/s^2; */
    double downwash_keep;  /* what a step keeps of it, */
    double downwash_fresh; /* and adds to it. */
    double cushion_share;  /* Share by which the ground effect follows in a step. */
    double induced_m_s;    /* Induced speed in hover, m/s. */
    double climb_keep;     /* What a step keeps of the error of the loops' climb rate, */
    double climb_fresh;    /* and adds to it, m/s. */
    double rate_sigma;     /* Standard deviation of the loops' turn rates, rad/s. */
    double loop_mass_kg;   /* The mass that the loops presume, kg. */
    double tilt_gain;      /* The tilt that the loops reach over the one requested. */
    double lift_share;     /* Share of its thrust that the vehicle gives. */
    double thing[4];       /* A thing on the deck: forward and right of the pad, radius and height, m. */
    double revolution_hz;  /* Revolutions of the rotors in hover, 1/s. */
} dl_sim_effects;

/* A vehicle: body, loops, rotors, feet, its errors, and the deck's outline. Loops are accelerations for each unit of error. */
typedef struct {
    bool quad_x;                                                     /* Four rotors at the corners. */
    int64_t rotors;                                                  /* Number of rotors. */
    bool effect_by_rotor;                                            /* The ground effect acts on each rotor by itself. */
    bool flow_sees_deck;                                             /* The optical flow measures against the deck. */
    bool flow_works;                                                 /* It measures at all. */
    bool motor_driven;                                               /* driven_n and driven_n_m fly it, not its own loops. */
    bool all_healthy;                                                /* Every rotor gives its full thrust. */
    int64_t delay_steps;                                             /* Steps that a stick command is under way. */
    double step_s;                                                   /* Length of a step, s. */
    double mass_kg, inertia_kg_m2[3];                                /* Mass, kg, and inertia about the body's axes, kg m^2. */
    double thrust_max_n, torque_max_n_m[3];                          /* Largest thrust, N, and torques, N m. */
    double motor_lag;                                                /* Share by which the motors follow in a step. */
    double arm_m, rotor_radius_m, rotors_above_m;                    /* Arm, rotor's radius, rotors over the origin, m. */
    double yaw_torque_per_thrust_m;                                  /* A rotor's reaction torque over its thrust, m. */
    double drag_per_s[3];                                            /* Linear drag along the body's axes, 1/s. */
    double rotor_forward[DL_ROTORS_MAX], rotor_right[DL_ROTORS_MAX]; /* Place of each rotor, in arms. */
    double rotor_spin[DL_ROTORS_MAX];                                /* 1 or -1 by its sense of rotation. */
    double rotor_squares[2];                                         /* Sums of the squares of both places. */
    double effect_radius_m;                                          /* Radius of one rotor with the area of all, m. */
    double rotor_health[DL_ROTORS_MAX];                              /* Share of its thrust that each rotor gives. */
    double landing_speed_m_s, take_off_speed_m_s;                    /* Speed down and up in these phases, m/s. */
    double take_off_height_m;                                        /* Height at which the take-off ends, m. */
    double motors_off_after_s;                                       /* Time on the deck after which the motors stop, s. */
    double tilt_cut_off_cos;                                         /* Cosine of the tilt at which they stop. */
    double tilt_p, tilt_d;                                           /* Gains of the attitude loop, 1/s^2 and 1/s. */
    double yaw_rate_p;                                               /* Gain of the yaw rate, 1/s. */
    double velocity_p, velocity_d, velocity_i;                       /* Gains of the velocity hold, 1/s, 1 and 1/s^2. */
    double velocity_i_max_m_s2;                                      /* Largest part of its integral, m/s^2. */
    double climb_p, climb_d, climb_i;                                /* Gains of the climb rate, 1/s, 1 and 1/s^2. */
    double climb_i_max_m_s2;                                         /* Largest part of its integral, m/s^2. */
    double height_p;                                                 /* Gain of the height hold, 1/s. */
    double observer_share;                                           /* Share by which the disturbance observer follows. */
    double unasked_max_rad_s2[3];                                    /* Largest disturbance that it assumes, rad/s^2. */
    double flow_scale, flow_lag;                                     /* Scale of the optical flow, and its share in a step. */
    double foot_m, feet_below_m, hull_top_m;                         /* Half of the feet's base, their depth, hull's top, m. */
    double foot_n_m, foot_n_s_m;                                     /* Stiffness of a foot, N/m, and its damping, N s/m. */
    double friction;                                                 /* Coefficient of friction. */
    double deck_fore_m, deck_aft_m;                                  /* The deck's ends before and behind the pad, m. */
    double deck_middle_m, deck_half_m;                               /* Its middle line from the pad, half its width, m. */
    double deck_taper_m;                                             /* Length of its tapered bow, m. */
    double deck_yaw[2];                                              /* Cosine and sine of its heading in the pad frame. */
    double gust_sigma_m_s, gust_keep, gust_fresh;                    /* Gusts: standard deviation, and how a step carries on. */
    double flow_keep, flow_fresh;                                    /* How a step carries the flow's error on. */
    double tilt_keep, tilt_fresh;                                    /* How a step carries the drift of the attitude on. */
    double wind[3];                                                  /* Steady wind in ned, m/s. */
    double tilt_max_rad;                                             /* Largest roll or pitch that a loop requests, rad. */
    double extra_wind[3];                                            /* A single gust as it passes, in ned, m/s. */
    double current[2];                                               /* Velocity of the water, north and east, m/s. */
    double euler_angle_max_rad;                                      /* Tilt of a full stick, rad; */
    double vz_max_m_s;                                               /* its climb rate, m/s; */
    double yaw_rate_max_rad_s;                                       /* its yaw rate, rad/s. */
    dl_sim_effects effects;                                          /* Further effects. */
    dl_sim_air_params air;                                           /* The air. */
} dl_sim_vehicle_params;

/* A vehicle's state. */
typedef struct {
    enum dl_sim_phase phase;             /* Phase of flight. */
    bool tied;                           /* It stands still on the deck and is carried with it. */
    bool ditched;                        /* It lies in the water. */
    enum dl_sim_touched touched_what;    /* What the newest contact after flight was with, */
    enum dl_sim_phase touched_phase;     /* and the phase before it. */
    int64_t pending_at;                  /* Place of the oldest stick command under way. */
    bool ship_known;                     /* The mean of the ship's velocity has begun. */
    double seconds;                      /* Time since the start, s. */
    double p[3], v[3];                   /* Place, m, and velocity, m/s, in ned. */
    double q[4], R[9];                   /* R_ned_body as unit quaternion (w, x, y, z) and as matrix. */
    double w[3];                         /* Turn rates in body, rad/s. */
    double a[3];                         /* Mean acceleration over the last step in ned, m/s^2. */
    double thrust_n, torque_n_m[3];      /* Thrust, N, and torques, N m, of the motors. */
    double flow[2];                      /* Its own estimate of the velocity forward and right, m/s. */
    double integral[3];                  /* Integrals of velocity hold (2) and climb rate, m/s^2. */
    double unasked_w[3];                 /* Turn rates at the disturbance observer's last step, rad/s, */
    double unasked[3];                   /* and the disturbance that it observes, rad/s^2. */
    double z_hold;                       /* Height that is held, down in ned, m. */
    double attached_d[3];                /* Place on the deck, where it is tied, in the pad frame, m, */
    double attached_q[4];                /* and R_pad_body. */
    double contact_s, airborne_s;        /* Time in contact, and in the air, s. */
    double touched_s;                    /* Instant of the first step of the newest contact, s; NaN before any. */
    double touched_d[3], touched_v[3];   /* Place, m, and velocity against the surface just before, m/s, in the pad frame. */
    double touched_R[9], touched_w[3];   /* R_pad_body at it, and turn rates against the deck just before, rad/s. */
    double gust[3];                      /* Gust in ned, m/s. */
    double flow_error[2];                /* Error of the optical flow, m/s. */
    double tilt_bias[2], tilt_drift[2];  /* Constant and drifting error of its roll and pitch, rad. */
    double air_u[2], air_v[2], air_w[2]; /* Lags of the turbulence along, across and down. */
    double eddy[3];                      /* Eddies of the wakes. */
    double ship[2];                      /* Mean of the ship's velocity, north and east, m/s. */
    double air[3];                       /* Velocity of the air in ned, without gust and extra_wind, m/s. */
    double driven_n, driven_n_m[3];      /* Thrust, N, and torques, N m, that another autopilot requests. */
    double rough[3];                     /* The downwash that the deck throws back. */
    double cushion;                      /* The lagging factor of the ground effect; 0 before the first step. */
    double climb_error;                  /* Error of the loops' climb rate, m/s. */
    double revolutions;                  /* Fraction of a rotor's turn, 0 to 1. */
    double command[5];                   /* Stick: roll, pitch, climb, yaw, -1 to 1; 1 unless it is to hover. */
    double pending[5 * DL_COMMANDS_MAX]; /* Commands under way, in a ring. */
} dl_sim_vehicle;

/* Sensors, by the errors of each. Pairs of standard deviations are with the motors off and on. */
typedef struct {
    int64_t echo_every, echo_delay;       /* Steps from echo to echo, and until one is reported. */
    double step_s;                        /* Length of a step, s. */
    double accel_sigma[2], gyro_sigma[2]; /* Noise, m/s^2 and rad/s. */
    double accel_scale, gyro_scale;       /* Readings over the truth. */
    double vibration;                     /* Amplitude of the rotors' vibration, m/s^2. */
    double accel_bias[3], gyro_bias[3];   /* Biases, m/s^2 and rad/s. */
    double heading_bias;                  /* Bias of the heading, rad. */
    double field_bias[3], field_sigma;    /* Bias and noise of the magnetometer, T. */
    double heading_keep, heading_fresh;   /* How a step carries the heading's drift on, rad. */
    double pressure_keep, pressure_fresh; /* How a step carries the pressure's drift on, Pa. */
    double pressure_sigma;                /* Noise of the pressure, Pa. */
    double cone_rad;                      /* Opening of the ultrasound's cone, rad. */
    double echo_sigma;                    /* Noise of an echo, m. */
    double echo_min_m, echo_max_m;        /* Range of distances that give an echo, m. */
    double battery_life_s;                /* Time of flight of a full battery, s. */
    double hover_n;                       /* Thrust of one rotor in hover, N. */
    int64_t motor[4];                     /* Rotors that the telemetry reports: front left, front right, rear right, rear left. */
} dl_sim_sensor_params;

/* The state of the sensors. */
typedef struct {
    int64_t tick;                           /* Number of steps. */
    int64_t echoes, first_echo;             /* Number of echoes under way, and place of the first. */
    double heading_drift, pressure_drift;   /* Drifts, rad and Pa. */
    double noise[DL_SENSOR_NOISE];          /* Standard normal numbers of the newest step. */
    double battery;                         /* Charge, 0 to 1. */
    double echo_m;                          /* Newest distance reported, m; NaN without echo. */
    double echo_due[DL_ECHOES_MAX];         /* Step at which each echo under way is reported, */
    double echo_under_way_m[DL_ECHOES_MAX]; /* and its distance, m. */
} dl_sim_sensors;

/* What the sensors read, in body axes. */
typedef struct {
    double f_body[3];       /* Specific force, m/s^2. */
    double w_body[3];       /* Turn rates, rad/s. */
    double rpy_rad[3];      /* Roll, pitch and heading by the drone's own estimate, rad. */
    double v_level_m_s[2];  /* Velocity forward and right by its own estimate, m/s. */
    double magnetometer[3]; /* Magnetic field, T. */
    double ultrasound_m;    /* Distance of the nearest surface in the cone, m; NaN without echo. */
    double pressure_pa;     /* Air pressure, Pa. */
    double battery;         /* Charge, 0 to 1. */
    double motors_pwm[4];   /* Pulse width of the four motors, 0 to 255. */
} dl_sim_readings;

/* The sea's height under a vehicle, which is not computed at every step. */
typedef struct {
    int64_t tick, every; /* Steps since it was computed, and from one to the next. */
    double z, vz;        /* Height down in ned, m, and its rate, m/s. */
} dl_sim_water;

/* A wave of the sea. */
typedef struct {
    double amplitude_m; /* Amplitude, m. */
    double k[2];        /* Wave number, north and east, rad/m. */
    double w_rad_s;     /* Frequency, rad/s. */
    double phase_rad;   /* Phase at the origin at time 0, rad. */
} dl_sim_wave;

/* A harmonic of a vessel's motion: complex amplitudes of surge, sway, heave, m, roll, pitch, yaw, rad. */
typedef struct {
    double w_rad_s;      /* Frequency of encounter, rad/s. */
    double re[6], im[6]; /* Real and imaginary parts. */
} dl_sim_harmonic;

/* A vessel's displacement in the six modes, m and rad. */
typedef struct {
    double eta[6], eta_dot[6], eta_ddot[6]; /* It, its rate, 1/s, and its acceleration, 1/s^2. */
} dl_sim_vessel_motion;

/* A vessel's place without waves, in ned. */
typedef struct {
    double p[3], v[3], a[3]; /* Place, m, velocity, m/s, and acceleration, m/s^2. */
    double heading_rad;      /* Heading, rad. */
} dl_sim_vessel_origin;

/* A point that is fixed to a vessel, with axes fixed to it. */
typedef struct {
    double d[3]; /* Place in the vessel, m. */
    double R[9]; /* Rotation in it. */
} dl_sim_mount;

/* The motion of such a point in ned. */
typedef struct {
    double p[3], v[3], a[3]; /* Place, m, velocity, m/s, and acceleration, m/s^2. */
    double R[9], w[3];       /* Rotation, and turn rate, rad/s. */
} dl_sim_mounted;

/* A vehicle with its sensors over a sea of some waves, at the addresses of what its steps read and write. */
typedef struct {
    const dl_sim_vehicle_params *vehicle_params; /* The vehicle, */
    dl_sim_vehicle *vehicle;                     /* and its state. */
    const dl_sim_sensor_params *sensor_params;   /* The sensors, */
    dl_sim_sensors *sensors;                     /* and their state. */
    dl_sim_water *water;                         /* The sea's height. */
    const dl_sim_wave *waves;                    /* The waves, */
    int64_t harmonics;                           /* and their number. */
} dl_sim_flight;

/* Take n steps over a deck, up to a contact after flight; return how many. Each takes DL_FLIGHT_NOISE numbers (also of the air),
 * DL_EFFECT_NOISE and DL_SENSOR_NOISE. */
int32_t dl_sim_run(const dl_sim_flight *f, int32_t n, const dl_sim_deck *decks, const double *noise, const double *air_noise,
    const double *effect_noise, const double *sensor_noise);
/* Take one step of a vehicle over a deck and a sea at a height, down in ned, with its rate. */
void dl_sim_vehicle_step(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const dl_sim_deck *g, double sea_z, double sea_vz,
    const double *noise, const double *air_noise, const double *effect_noise);
/* Carry a vehicle that is tied to the deck along with it. */
void dl_sim_vehicle_carry(dl_sim_vehicle *v, const dl_sim_deck *g);
/* Read the sensors; it changes nothing. */
void dl_sim_sensors_read(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v, const dl_sim_sensor_params *e,
    const dl_sim_sensors *s, dl_sim_readings *out);

/* Compute a vessel's motion at n times about her steady course, by harmonics. */
void dl_sim_vessel_moved(int32_t harmonics, const dl_sim_harmonic *h, int32_t n, const double *t_s, dl_sim_vessel_motion *out);
/* Compute the motion of a point which is fixed to her. */
void dl_sim_vessel_mounted(int32_t n, const dl_sim_vessel_origin *origin, const dl_sim_vessel_motion *m, const dl_sim_mount *at,
    dl_sim_mounted *out);

/* ---- training/: many flights of one scenario, step by step, for controllers that learn ---- */

/* The numbers of an action, each -1 to 1: acceleration (or velocity) forward and right, velocity down against the deck, yaw rate. */
enum dl_sim_action {
    DL_ACTION_FORWARD, DL_ACTION_RIGHT, DL_ACTION_DOWN, DL_ACTION_YAW, DL_ACTION_NUMBERS,
};

/* Where the parts of an observation begin: the pad's place (3) m and its velocity against the body (3) m/s in level axes, the body's
 * tilt and the trim against wind and drag as accelerations (2 + 2) m/s^2 forward and right, the deck's velocity
 * and acceleration down, its roll and pitch about the body's heading, sine and cosine of the heading against the arrow, the last
 * action, seconds since the last sighting. */
enum dl_sim_view {
    DL_VIEW_PLACE = 0, DL_VIEW_VELOCITY = 3, DL_VIEW_LEAN = 6, DL_VIEW_TRIM = 8, DL_VIEW_DECK = 10, DL_VIEW_DECK_TILT = 12,
    DL_VIEW_HEADING = 14, DL_VIEW_ACTION = 16, DL_VIEW_AGE = 20, DL_VIEW_NUMBERS = 21,
};

/* The terms of a reward, before their weights. */
enum dl_sim_reward {
    DL_REWARD_NEARER, DL_REWARD_OUTSIDE, DL_REWARD_EFFORT, DL_REWARD_TIME, DL_REWARD_LANDED, DL_REWARD_MISSED_BY, DL_REWARD_SPEED,
    DL_REWARD_FAILED, DL_REWARD_TERMS,
};

/* How an episode ended. */
enum dl_sim_episode {
    DL_EPISODE_GOES_ON, DL_EPISODE_LANDED, DL_EPISODE_OFF_PAD, DL_EPISODE_HARD, DL_EPISODE_IN_WATER, DL_EPISODE_LEFT,
    DL_EPISODE_TIMED_OUT,
};

/* What a wrong model changes: factors on the vehicle's, and seconds of delay more. */
enum dl_sim_wrong {
    DL_WRONG_TILT_FREQUENCY, DL_WRONG_TILT_DAMPING, DL_WRONG_THRUST, DL_WRONG_DRAG, DL_WRONG_COMMAND_DELAY_S, DL_WRONG_NUMBERS,
};

enum {
    /* The largest number of harmonics of a vessel's motion. */
    DL_HARMONICS_MAX = 256,
    /* The largest number of observations that may be under way. */
    DL_VIEWS_MAX = 16,
};

/* A harmonic of a vessel's displacement (6) and rate (6). */
typedef struct {
    double by_re[12], by_im[12]; /* Both by the real and by the imaginary part of its phasor. */
    double turn_re, turn_im;     /* What turns the phasor by a step of the controller. */
} dl_sim_sway;

/* What is the same for all worlds: the scenario, and the rules of the training. */
typedef struct {
    int64_t harmonics;                    /* Number of harmonics. */
    int64_t physics_steps;                /* Steps of physics in one of the controller. */
    int64_t steps_max;                    /* Steps after which an episode times out. */
    bool velocity_actions;                /* Actions forward and right are velocities. */
    bool true_view;                       /* Observations are without errors. */
    int64_t view_delay;                   /* Steps by which they are late. */
    double step_s;                        /* Length of a step of the controller, s. */
    double cos_course, sin_course;        /* Cosine and sine of the vessel's course. */
    double acceleration_max_m_s2;         /* Acceleration of a full action, m/s^2. */
    double velocity_max_m_s;              /* Velocity of a full action, where actions are velocities, m/s, */
    double velocity_gain;                 /* and the gain that reaches it, 1/s. */
    double down_max_m_s;                  /* Velocity down of a full action, m/s. */
    double yaw_rate_max_rad_s;            /* Yaw rate of a full action, rad/s. */
    double start_low[4], start_high[4];   /* Limits of the start: the pad forward and right, height over it, m; heading, rad. */
    double pad_radius_m;                  /* Radius of the pad, m. */
    double vertical_max_m_s;              /* The fastest contact, down, that counts as landed, m/s, */
    double lateral_max_m_s;               /* and along the deck. */
    double reach_m;                       /* An episode ends this far from the pad, m. */
    double trim_keep;                     /* What a step keeps of the trim's mean. */
    double place_sigma_m;                 /* Standard deviation of the pad's place at touchdown, m, */
    double place_sigma_by_height;         /* and what it grows by with each metre of height. */
    double velocity_sigma_m_s;            /* Standard deviation of the velocity against it, m/s, */
    double velocity_sigma_by_height;      /* and what it grows by with each metre of height, 1/s. */
    double error_keep, error_fresh;       /* How a step carries both errors on. */
    double tilt_sigma_rad;                /* Standard deviation of the attitude's constant error, rad. */
    double lost_share, found_share;       /* Chances that a step loses the pad, and finds it again. */
    double wrong_sigma[DL_WRONG_NUMBERS]; /* Standard deviations of the wrong model. */
    dl_sim_vessel_origin course;          /* The vessel's course. */
    dl_sim_mount pad;                     /* The pad on her. */
    dl_sim_vehicle_params vehicle_params; /* The vehicle, */
    dl_sim_vehicle vehicle;               /* and its state at the start. */
    dl_sim_sway sway[DL_HARMONICS_MAX];   /* The harmonics. */
} dl_sim_training;

/* One world. */
typedef struct {
    uint64_t random[4];                          /* State of its random numbers. */
    int64_t steps;                               /* Steps of the episode. */
    int64_t lost;                                /* Steps since the last sighting. */
    int64_t view_at;                             /* Place of the newest observation. */
    double t_s;                                  /* Time of the episode, s. */
    double deck_at[2][12];                       /* The vessel's displacement and rate at both ends of the step. */
    double error[6];                             /* Errors of place and velocity, in standard deviations. */
    double trim[2];                              /* The trim against wind and drag, m/s^2. */
    double action[DL_ACTION_NUMBERS];            /* The last action. */
    double goal_m;                               /* The way that is left, m. */
    double phasor_re[DL_HARMONICS_MAX];          /* The phasors of the sea, real */
    double phasor_im[DL_HARMONICS_MAX];          /* and imaginary part. */
    float views[DL_VIEWS_MAX * DL_VIEW_NUMBERS]; /* Observations under way, in a ring. */
    dl_sim_deck deck;                            /* The deck at the end of the step. */
    dl_sim_vehicle_params vehicle_params;        /* The vehicle, */
    dl_sim_vehicle vehicle;                      /* and its state. */
} dl_sim_training_world;

/* What a step of `count` worlds gives, one row a world. */
typedef struct {
    float *views;      /* The observation. */
    float *terms;      /* The terms of its reward. */
    float *last_views; /* The last observation of an episode that ended. */
    float *touchdowns; /* Its touchdown: distance from the centre, m, speeds down and along the deck, m/s; NaN without one. */
    int8_t *ends;      /* How it ended, of dl_sim_episode. */
} dl_sim_training_step;

/* Begin an episode of every world with its random state; write the observations. */
void dl_sim_training_begin(const dl_sim_training *rules, int32_t count, dl_sim_training_world *worlds, float *views);
/* Take one step of the controller in every world by DL_ACTION_NUMBERS each. A world whose episode ends begins the next one. */
void dl_sim_training_step_all(const dl_sim_training *rules, int32_t count, dl_sim_training_world *worlds, const float *actions,
    const dl_sim_training_step *out);

/* ---- render/ and sea/: what a camera sees ---- */

/* The paints of a pad, in the order of their shares; the first is what lies around it. */
enum dl_sim_paint {
    DL_PAD_NONE, DL_PAD_RIM, DL_PAD_DISC, DL_PAD_ORANGE, DL_PAD_WHITE, DL_PAD_UPPER, DL_PAD_PAINTS,
};

/* The first numbers of a painted region: its shape, its paint, the paint that it lies on, and its least and largest
 * distance from the centre, m; then those of its shape. */
enum dl_sim_region {
    DL_PAD_SHAPE, DL_PAD_PAINT, DL_PAD_BELOW, DL_PAD_NEAREST, DL_PAD_FARTHEST, DL_PAD_SHAPE_NUMBERS,
};

/* The shapes of regions, and their numbers: m from the centre, and the direction of the arrowhead's sides. A convex
 * polygon of up to four sides has for each its normal outward and its distance from the centre, m, one after the other
 * from the first. */
enum dl_sim_shape {
    DL_PAD_ANNULUS, DL_PAD_RECTANGLE, DL_PAD_ARROW, DL_PAD_POLYGON,
};

enum {
    DL_PAD_ANNULUS_INNER = DL_PAD_SHAPE_NUMBERS, DL_PAD_ANNULUS_OUTER,
};

enum {
    DL_PAD_RECTANGLE_U0 = DL_PAD_SHAPE_NUMBERS, DL_PAD_RECTANGLE_U1, DL_PAD_RECTANGLE_V0, DL_PAD_RECTANGLE_V1,
};

enum {
    DL_PAD_ARROW_TIP = DL_PAD_SHAPE_NUMBERS, DL_PAD_ARROW_BASE, DL_PAD_ARROW_COS, DL_PAD_ARROW_SIN,
};

enum {
    DL_PAD_POLYGON_SIDES = DL_PAD_SHAPE_NUMBERS, DL_PAD_POLYGON_FIRST,
    /* The numbers of a region. */
    DL_PAD_REGION = DL_PAD_POLYGON_FIRST + 12,
};

/* The strengths of what lies on the sea: small and large ripples, the height below which no crest breaks, the brightness
 * of those that do, the largest share of light that a ship's shade takes, and the brightness of full foam beside and
 * behind her. */
enum dl_sim_sea {
    DL_SEA_SMALL, DL_SEA_LARGE, DL_SEA_CALM, DL_SEA_CAP, DL_SEA_SHADE, DL_SEA_WASH, DL_SEA_WAKE, DL_SEA_WEIGHTS,
};

/* A part of the frame, px: its first column and row, and their numbers. */
enum dl_sim_window {
    DL_LENS_X, DL_LENS_Y, DL_LENS_COLUMNS, DL_LENS_ROWS, DL_LENS_NUMBERS,
};

enum {
    /* Value of a factor of one on simulated light. */
    DL_GAIN_ONE = 16384,
    /* Value of a scene's pixel that reflects all light, and of wear that does not change it. */
    DL_SCENE_ONE = 32768,
    /* Distance between the rays at which planes are met exactly, px. */
    DL_CELL_PX = 8,
    /* The widest blur of the simulated lens, px. */
    DL_BLUR_RADIUS_MAX = 30,
    /* Light up to this many counts is distinguished by single counts when noise is added to it, then by four. */
    DL_LEVELS_BY_ONE = 512,
    /* Light from this many counts on is distinguished by eight. */
    DL_COUNTS_BY_EIGHT = 4096,
    /* The number of levels below that. */
    DL_LEVELS_BY_EIGHT = DL_LEVELS_BY_ONE + (DL_COUNTS_BY_EIGHT - DL_LEVELS_BY_ONE) / 4,
    /* The number of levels of light; the last one holds all light that is brighter. */
    DL_LIGHT_LEVELS = 2048,
    /* The number of levels of noise. */
    DL_GRAIN_LEVELS = 32,
    /* Value of one in a texture of the sea. */
    DL_TILE_ONE = 4096,
    /* The number of outlines of a ship on the water: her shadow, her hull, and her wake. */
    DL_SEA_OUTLINES = 3,
    /* The largest number of points of one of them. */
    DL_SEA_OUTLINE_POINTS = 48,
    /* Kind of a pixel that shows several paints. */
    DL_PAD_EDGE = 255,
    /* Numbers of one part of an exposure: homographies in its middle, their change during it, in the first row and in the last. */
    DL_STROKE_NUMBERS = 36,
    /* Number of columns of a row that are blurred exactly together, or left as they are. */
    DL_LENS_BLOCK = 16,
    /* The largest number of regions: disc, rim, ring, arrowhead, and the rectangles and convex pieces of lettering of two paints. */
    DL_PAD_REGIONS_MOST = 784,
};

/* A part of a frame. */
typedef struct {
    int32_t w;      /* Columns of the whole frame. */
    int32_t x0, x1; /* First column, and the one behind the last. */
    int32_t y0, y1; /* First row, and the one behind the last. */
} dl_sim_frame_part;

/* Where rays meet a plane: the middles of cells of DL_CELL_PX x DL_CELL_PX pixels, with one cell more on each side than the frame
 * has. */
typedef struct {
    const float *at; /* Two numbers for each cell, m. */
    int32_t columns; /* Number of columns of cells. */
} dl_sim_plane_cells;

/* A drawing. */
typedef struct {
    const uint16_t *texels; /* (h, w, 4): what it reflects of blue, green and red, and its wear, parts of DL_SCENE_ONE. */
    int32_t h, w;           /* Its rows and columns. */
} dl_sim_drawing;

/* Find where rays meet a plane, (count, 2). */
void dl_sim_render_meet(int32_t count, const float *rays, const double *plane_from_ray, double most, float *places);
/* Find the bounds x0, x1, y0, y1 of what a mask covers, and of what it leaves open. */
void dl_sim_render_bounds(int32_t h, int32_t w, const uint8_t *mask, int32_t *covered, int32_t *open);
/* Draw on a part of a scene as far as a mask of the whole frame covers it, or wholly without one. */
void dl_sim_render_deck(const dl_sim_frame_part *part, const dl_sim_plane_cells *cells, const dl_sim_drawing *drawn,
    const uint8_t *mask, uint16_t *scene);
/* Colour a part of a scene as far as a mask of this part covers it. */
void dl_sim_render_fill(const dl_sim_frame_part *part, const uint8_t *mask, const uint16_t *colour, uint16_t *scene);

/* A drone's shadow. */
typedef struct {
    float rotor_at_m;     /* The rotors' place along and across, m. */
    float rotor_radius_m; /* Their guards' radius, m. */
    float half_length_m;  /* Half of the hull's length, m, */
    float half_width_m;   /* and width, m. */
    float soft_m;         /* Width of the soft edge, m. */
    float share;          /* Share of light that it takes. */
} dl_sim_drone_shade;

/* Darken factors on the light, (h, w), by a shadow; its bounds are x0, x1, y0, y1. */
void dl_sim_render_shadow(int32_t h, int32_t w, const dl_sim_plane_cells *cells, const dl_sim_drone_shade *shade, const uint8_t *mask,
    int16_t *gain, int32_t *bounds);
/* Sum `count` shifted scenes by their weights, parts of 65536. */
void dl_sim_render_smear(int32_t h, int32_t w, const uint16_t *scene, int32_t count, const int32_t *shifts, const uint16_t *weights,
    uint16_t *smeared);
/* Average two shifted scenes. */
void dl_sim_render_average(int32_t h, int32_t w, const uint16_t *scene, const int32_t *shifts, uint16_t *averaged);

/* A periodic texture on the sea. */
typedef struct {
    const int16_t *texels;   /* n x n texels, with the first row and column repeated, parts of DL_TILE_ONE. */
    int32_t n;               /* Texels of a side. */
    double per_m;            /* Texels for each metre. */
    double shift_x, shift_y; /* Shift, in texels. */
} dl_sim_sea_layer;

/* What the sea's surface is painted from. */
typedef struct {
    dl_sim_sea_layer small, large;           /* Ripples of two sizes. */
    dl_sim_sea_layer caps, streaks;          /* Whitecaps and streaks of foam. */
    float weights[DL_SEA_WEIGHTS];           /* The strengths of dl_sim_sea. */
    const float *slow;                       /* Level and contrast of the light for every second cell, of dl_sim_render_swell. */
    const double *outlines;                  /* A ship's shadow, hull and wake, one after the other, (points, 2) m. */
    int32_t outline_points[DL_SEA_OUTLINES]; /* Their points. */
    float soft_m[DL_SEA_OUTLINES];           /* Widths of their soft edges, m. */
} dl_sim_sea_surface;

/* Code the brightness of a part of the sea in squares of 2 x 2 pixels; the part counts squares, but its w is the frame's, px. */
void dl_sim_render_sea(int32_t h, const dl_sim_frame_part *part, const dl_sim_plane_cells *cells, const dl_sim_sea_surface *sea,
    const uint8_t *mask, uint8_t *codes);
/* Colour a part of a scene by the codes of its squares. */
void dl_sim_render_water(const dl_sim_frame_part *part, const uint8_t *codes, const uint16_t *colours, const uint8_t *mask,
    uint16_t *scene);

/* The swell under a camera. */
typedef struct {
    double R_ned_cam[9];      /* The camera's rotation. */
    double plane_from_ray[9]; /* From rays to places on the water, m. */
    double to_sun[3];         /* Unit direction to the sun in ned. */
    double t_s;               /* Time, s. */
    const dl_sim_wave *waves; /* The waves, */
    int64_t harmonics;        /* and their number. */
} dl_sim_swell;

/* Compute level and contrast of the sea's light for every second cell, (rows / 2 + 1, columns / 2 + 1, 2). */
void dl_sim_render_swell(int32_t rows, int32_t columns, const float *rays, const dl_sim_swell *s, float *light);

/* A pad in a frame. */
typedef struct {
    int32_t h, w;         /* Rows and columns of the frame. */
    bool bent;            /* The lens is bent: `change` is of each pixel, else one for all. */
    bool rolling;         /* Rows are exposed one after the other. */
    int32_t regions;      /* Number of regions. */
    const float *rays;    /* Rays of the pixels. */
    const float *change;  /* Their change from pixel to pixel. */
    const float *middles; /* Rays of the middles of cells. */
    const float *pad;     /* The regions, DL_PAD_REGION numbers each. */
} dl_sim_pad_view;

/* Find the paint of each pixel by the homographies of the whole exposure, and the pixels that edges touch; return how many. */
int32_t dl_sim_render_pad_kinds(const dl_sim_pad_view *v, const float *whole, uint8_t *kinds, int32_t *edges);
/* Compute the coverage of `count` pixels by the paints during this many strokes, and of their fine x fine parts. */
void dl_sim_render_pad_shares(const dl_sim_pad_view *v, int32_t strokes, const float *stroke_numbers, int32_t fine, int32_t count,
    const int32_t *edges, float *shares, float *parts);

/* A scene in a light. */
typedef struct {
    int32_t h, w;              /* Rows and columns. */
    int32_t edges;             /* Number of pixels that edges of the pad touch. */
    int32_t fine;              /* Parts of a pixel along a side. */
    const uint16_t *scene;     /* The pixels, (h, w, 4) parts of DL_SCENE_ONE. */
    const uint8_t *kinds;      /* The pad's paint on them, of dl_sim_paint, or null. */
    const int16_t *gain;       /* Factors on the light, (h, w) parts of DL_GAIN_ONE. */
    const float *exposure;     /* Counts of a pixel that reflects all light, by channel. */
    const uint16_t *pad_scene; /* What the pad's paints reflect, (DL_PAD_PAINTS, 4). */
    const int32_t *where;      /* The pixels that edges touch, by their numbers. */
    const float *shares;       /* Their coverage by the paints, */
    const float *parts;        /* and that of their fine x fine parts. */
} dl_sim_lit_scene;

/* Compute the light of a scene, (h, w, 3), without the pixels of edges. */
void dl_sim_render_expose(const dl_sim_lit_scene *seen, int16_t *light);
/* Mix the pixels of edges into it. */
void dl_sim_render_mix(const dl_sim_lit_scene *seen, int16_t *light);

/* The kernels of a lens. */
typedef struct {
    int32_t reach;        /* How far they reach, px. */
    int32_t floats;       /* Length of `room`, */
    int32_t numbers;      /* and of `places`. */
    const float *exact;   /* The kernel on parts of pixels. */
    const float *sampled; /* The kernel on pixels. */
    float *room;          /* Memory to work in. */
    int32_t *places;      /* Memory to work in. */
} dl_sim_lens_kernels;

/* Compute what the blur of a lens makes of the pad's edges in a window beyond what a blur of pixels does, (rows, 3, columns).
 * Return whether there is room for it. */
bool dl_sim_render_pad_lens(const dl_sim_lit_scene *seen, const int32_t *window, const dl_sim_lens_kernels *k, int16_t *added);

/* The blur of a lens. */
typedef struct {
    int32_t radius;        /* Its radius, px. */
    int32_t numbers;       /* Length of `scratch`. */
    const uint16_t *taps;  /* Its weights. */
    const int32_t *window; /* The window in which something is added, of dl_sim_window, or null; */
    const int16_t *added;  /* what is added there. */
    uint16_t *scratch;     /* Memory to work in. */
} dl_sim_lens_blur;

/* The sensor. */
typedef struct {
    const uint8_t *noise; /* Level of noise for each value, or null. */
    const uint8_t *codes; /* Values of the frame by light and noise. */
} dl_sim_sensor_tone;

/* Blur light, (h, w, 3). This and the next two return whether there is room. */
bool dl_sim_render_blur(int32_t h, int32_t w, const int16_t *light, const dl_sim_lens_blur *blur, int16_t *out);
/* Make a frame of light. */
bool dl_sim_render_frame(int32_t h, int32_t w, const int16_t *light, const dl_sim_lens_blur *blur, const dl_sim_sensor_tone *tone,
    uint8_t *frame);
/* Make a frame of a scene. */
bool dl_sim_render_image(const dl_sim_lit_scene *seen, const dl_sim_lens_blur *blur, const dl_sim_sensor_tone *tone, uint8_t *frame);

#endif
