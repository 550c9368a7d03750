/* Made from interface/ by `python -m supply.core --header`. */
#ifndef DECKLANDER_INTERFACE_H
#define DECKLANDER_INTERFACE_H

#include <stdint.h>

#define N 54
#define ATT_ERR 0
#define POS_REL 3
#define VEL 6
#define GYRO_BIAS 9
#define ACCEL_BIAS 12
#define VEL_SCALE 15
#define VESSEL_VEL 16
#define WAVES 18
#define PAD_YAW 38
#define YAW_RATE 39
#define DECK_TRIM 40
#define CAMERA_DELAY 42
#define CAMERA_MOUNT 43
#define BARO_OFFSET 46
#define ATT_BIAS 47
#define RANGE_OFFSET 49
#define WAVE_YAW 50
#define TURN_RATE 51
#define SWAY_PER_HEAVE 52
#define ORDER_MAX 54
#define ROWS_MAX 9
#define COLUMNS_MAX 14
#define KINDS 4
#define DIRECTIONS 5
#define OSCILLATORS 28
#define MEMBER_SIZES 5
#define WAVE_PAIRS 10
#define MEMBERS 136
#define MEMBER_STATES 7
#define MEMBER_PAIRS 28
#define SKILL_HORIZONS 3
#define ISSUED_MAX 9
#define EXCESSES_MAX 24
#define ATTITUDE 0
#define VELOCITY 1
#define RANGE 2
#define HEIGHT 3
#define IMU 4
#define VESSEL 5
#define SIGHTING 6
#define FUSED 0
#define GATED 1
#define SINGULAR 2
#define LOW_CONFIDENCE 3
#define OVER_GROUND 0
#define OVER_PAD 1
#define OVER_EITHER 2
#define STATE_ALONE 0
#define WITH_COVARIANCE 1
#define WITH_AIDING 2
#define UNDER_WAY_MAX 132
#define EDGE_KINDS 5
#define PAD_CONTRASTS 5
#define REGION_CIRCLES 2
#define PAD_FIGURES 4
#define FIGURE_CUTS 64
#define FIGURE_RECTANGLES 320
#define FIGURE_SIDES 64
#define WEDGE_SIDES 4
#define FIT_ROWS 148
#define POINTER_MARKS 4
#define FRAME_LEVELS 5
#define TEMPLATE_BLURS 5
#define TEMPLATE_ONE 16384
#define LOCAL_MAX 128
#define SAMPLE_LANES 8
#define SCRATCH_ROWS 35
#define APPROACH_SAMPLES 1000
#define APPROACH_STEPS 6
#define FINAL_SAMPLES 2600
#define FEATURES 31
#define FEATURE_ONE 0
#define FEATURE_H_MARKING 1
#define FEATURE_RING 2
#define FEATURE_EDGE 3
#define FEATURE_H_MARKING_ALL 4
#define FEATURE_RING_ALL 5
#define FEATURE_EDGE_ALL 6
#define FEATURE_H_AND_RING 7
#define FEATURE_H_AND_EDGE 8
#define FEATURE_RING_AND_EDGE 9
#define FEATURE_TWO_OF_THREE 10
#define FEATURE_SOME_RING 11
#define FEATURE_SOME_EDGE 12
#define FEATURE_SOME_TWO 13
#define FEATURE_H_ALONE 14
#define FEATURE_NO_H 15
#define FEATURE_NO_RING 16
#define FEATURE_NO_EDGE 17
#define FEATURE_RING_LAGS 18
#define FEATURE_FLANKS 19
#define FEATURE_ARROW 20
#define FEATURE_NO_ARROW 21
#define FEATURE_TEMPLATE_GAIN 22
#define FEATURE_INLIERS 23
#define FEATURE_WHITE 24
#define FEATURE_ORANGE_PLACE 25
#define FEATURE_ORANGE_ODD 26
#define FEATURE_DISC_PLACE 27
#define FEATURE_SIZE 28
#define FEATURE_IN_VIEW 29
#define FEATURE_TILT 30
#define EVIDENCE 29
#define EVIDENCE_ONE 0
#define EVIDENCE_TEMPLATE_SCORE 1
#define EVIDENCE_INLIERS 2
#define EVIDENCE_DISC_OFF 3
#define EVIDENCE_RING_OFF 4
#define EVIDENCE_H_OFF 5
#define EVIDENCE_RING_UNSEEN 6
#define EVIDENCE_H_UNSEEN 7
#define EVIDENCE_DENSE 8
#define EVIDENCE_DENSE_INLIERS 9
#define EVIDENCE_RMS 10
#define EVIDENCE_VISIBLE 11
#define EVIDENCE_DENSE_TEMPLATE_SCORE 12
#define EVIDENCE_DENSE_DISC 13
#define EVIDENCE_DENSE_ORANGE 14
#define EVIDENCE_NO_RING 15
#define EVIDENCE_NO_H 16
#define EVIDENCE_DISC_UNSEEN 17
#define EVIDENCE_PAINTED 18
#define EVIDENCE_NO_DISC 19
#define EVIDENCE_H_CONTRAST_ODD 20
#define EVIDENCE_DISAGREES 21
#define EVIDENCE_NOT_BRIGHTER 22
#define EVIDENCE_CORNER 23
#define EVIDENCE_EDGES_ASTRAY 24
#define EVIDENCE_H_ASTRAY 25
#define EVIDENCE_HALF_DISAGREES 26
#define EVIDENCE_NO_H_IN_VIEW 27
#define EVIDENCE_H_DISAGREES 28
#define LAMPS 40
#define LAMP_PAIRS 20
#define LAMP_SPOTS 40
#define SEARCH_BLOCK 16
#define SEARCH_CELL 2
#define SEARCH_RADII 12
#define SEARCH_SECTORS 36
#define SEARCH_LEVELS 5
#define POLAR_RADII 18
#define POLAR_ANGLES 48
#define GAIN_ONE 16384
#define SCENE_ONE 32768
#define CELL_PX 8
#define BLUR_RADIUS_MAX 30
#define LEVELS_BY_ONE 512
#define COUNTS_BY_EIGHT 4096
#define LEVELS_BY_EIGHT 1408
#define LIGHT_LEVELS 2048
#define GRAIN_LEVELS 32
#define TILE_ONE 4096
#define SEA_OUTLINES 3
#define SEA_OUTLINE_POINTS 48
#define PAD_PAINTS 6
#define PAD_EDGE 255
#define STROKE_NUMBERS 36
#define LENS_BLOCK 16
#define PAD_REGION 18
#define PAD_REGIONS_MOST 784
#define PAD_NONE 0
#define PAD_RIM 1
#define PAD_DISC 2
#define PAD_ORANGE 3
#define PAD_WHITE 4
#define PAD_UPPER 5
#define SEA_SMALL 0
#define SEA_LARGE 1
#define SEA_CALM 2
#define SEA_CAP 3
#define SEA_SHADE 4
#define SEA_WASH 5
#define SEA_WAKE 6
#define PAD_SHAPE 0
#define PAD_PAINT 1
#define PAD_BELOW 2
#define PAD_NEAREST 3
#define PAD_FARTHEST 4
#define PAD_ANNULUS 0
#define PAD_RECTANGLE 1
#define PAD_ARROW 2
#define PAD_POLYGON 3
#define LENS_X 0
#define LENS_Y 1
#define LENS_COLUMNS 2
#define LENS_ROWS 3
#define PAD_ANNULUS_INNER 5
#define PAD_ANNULUS_OUTER 6
#define PAD_RECTANGLE_U0 5
#define PAD_RECTANGLE_U1 6
#define PAD_RECTANGLE_V0 7
#define PAD_RECTANGLE_V1 8
#define PAD_ARROW_TIP 5
#define PAD_ARROW_BASE 6
#define PAD_ARROW_COS 7
#define PAD_ARROW_SIN 8
#define PAD_POLYGON_SIDES 5
#define PAD_POLYGON_FIRST 6
#define PAD_POLYGON_1 7
#define PAD_POLYGON_2 8
#define PAD_POLYGON_3 9
#define PAD_POLYGON_4 10
#define PAD_POLYGON_5 11
#define PAD_POLYGON_6 12
#define PAD_POLYGON_7 13
#define PAD_POLYGON_8 14
#define PAD_POLYGON_9 15
#define PAD_POLYGON_10 16
#define PAD_POLYGON_11 17
#define ROTORS_MAX 6
#define GUSTS_MAX 100
#define COMMANDS_MAX 1024
#define ECHOES_MAX 64
#define FLIGHT_NOISE 7
#define SENSOR_NOISE 13
#define IMU_NOISE 0
#define FIELD_NOISE 6
#define PRESSURE_NOISE 9
#define HEADING_DRIFT 10
#define PRESSURE_DRIFT 11
#define ECHO_NOISE 12
#define PHASE_LANDED 0
#define PHASE_TAKING_OFF 1
#define PHASE_HOVERING 2
#define PHASE_FLYING 3
#define PHASE_LANDING 4
#define PHASE_EMERGENCY 5
#define TOUCHED_DECK 1
#define TOUCHED_SEA 2
#define UVLC_DONE 0
#define UVLC_SHORT 1
#define UVLC_NO_PICTURE 2
#define UVLC_SIZE 3
#define UVLC_INTER 4
#define UVLC_TORN 5
#define UVLC_BAD_CODE 6
#define UVLC_WIDTH_MAX 640
#define UVLC_HEIGHT_MAX 480

typedef struct {
    double w[136];
    double zeta[136];
    double log_zeta[136];
    double log_prior[136];
    double sigma[680];
} bank_members;

typedef struct {
    int64_t t;
    double waves[30];
} issued_forecast;

typedef struct {
    int64_t issued_n;
    issued_forecast issued[9];
    double n[3];
    double product[30];
    double square[30];
    double came[30];
} forecast_skill;

typedef struct {
    int64_t t;
    double w_rad_s[5];
    double zeta[5];
    double sigma[5];
    forecast_skill skill;
    double log_weight[680];
    double weight[680];
    double x[4760];
    double P[19040];
} sea;

typedef struct {
    int64_t hold_ns;
    int64_t velocity_is_over;
    int64_t reopen_count;
    int64_t sighting_has_attitude_error;
    double tick_s;
    double forget_s;
    double aiding_period_s;
    double accel_step_m_s2;
    double gyro_step_rad_s;
    double deck_radius_m;
    double not_measured_var;
    double correlation_s[4];
    double nis_max[9];
    double psd[54];
    double psd_accel;
    double psd_coast;
    double psd_coast_turn;
    double wave_yaw_rad_s;
    double sigma_wave_yaw_rate_rad_s;
    double carrying_psd_accel[5];
    double carrying_psd_drift[5];
    double carrying_psd_tilt[5];
    double min_confidence;
    double reopen_s;
    double heading_memory_s;
    double sigma_sway_per_heave;
    double sigma_turn_rate_rad_s;
    double pad_yaw_in_vessel_rad;
    bank_members members;
} filter_params;

typedef struct {
    int64_t fused;
    int64_t refused;
    int64_t n;
    int64_t since;
    int64_t m;
    int64_t axes;
    double deck_weight;
    double innov[3];
    double R[9];
    double ambiguity[9];
    double spread[9];
    double H[42];
} aid;

typedef struct {
    int64_t n;
    int64_t t[24];
    double values[72];
} innovation_excesses;

typedef struct {
    int64_t t;
    int64_t t_cov;
    int64_t t_imu;
    int64_t t_velocity;
    int64_t sighted;
    int64_t agreed;
    int64_t is_levelled;
    int64_t heading_is_given;
    int64_t rejected_n;
    int64_t rejected_since;
    int64_t rejected_last;
    int64_t heading_known;
    int64_t heading_seen;
    double rejected_offset_ned[3];
    double rejected_var_m2;
    double R[9];
    double x[54];
    double R_cov[9];
    double dv[3];
    double dp[3];
    double turned[9];
    double coast_s;
    double w[3];
    double w_smooth[3];
    double f[3];
    double levelled_by[9];
    double cov_levelled_by[9];
    double ins_p[3];
    double ins_v[3];
    double ins_var_m2_s2;
    double jolt_var_m2_s2;
    double jolt_var_rad2;
    double over_pad;
    double wave_w[5];
    double wave_zeta[5];
    double wave_sigma[5];
    double nis_mean;
    double heading_held_s;
    aid aids[4];
    innovation_excesses excesses;
} belief;

typedef struct {
    int64_t kind;
    int64_t t;
    double value[18];
} event;

typedef struct {
    int64_t has_yaw;
    int64_t yaw_ambiguous;
    int64_t has_pose6;
    double confidence;
    double sigma_s;
    double d_level[3];
    double yaw_rad;
    double cov[16];
    double pose_d_level[3];
    double pose_R[9];
    double pose_cov[36];
} sighting;

typedef struct {
    int64_t verdict;
    int64_t m;
    int64_t axes;
    int64_t has_S;
    double innov[6];
    double S[36];
    double nis;
    double nis_max;
} outcome;

typedef struct {
    double row[224];
    double noise[56];
    double squares[840];
} horizon_reach;

typedef struct {
    double d[3];
    double cov_d[9];
    double v_pad[3];
    double height;
    double sigma_height;
    double rise;
    double sigma_rise;
    double roll;
    double sigma_roll;
    double pitch;
    double sigma_pitch;
} deck_ahead;

typedef struct {
    int64_t has_pad;
    int64_t has_body;
    int64_t sighted;
    int64_t agreed;
    int64_t velocity_fused;
    int64_t heading_known;
    double nis_mean;
    double heading;
    double d[3];
    double v[3];
    double yaw;
    double cov[49];
    double a_body[3];
    double cov_a_body[9];
    double w_body[3];
    double levelled_by[9];
    double cov_levelled_by[9];
    double v_deck[3];
    double a_deck[3];
    double cov_deck[36];
    double tilt[4];
    double cov_tilt[16];
    double x[54];
    double var[54];
    double cov_vessel;
    double wave_w[5];
    double wave_zeta[5];
    double wave_sigma[5];
} answer;

typedef struct {
    int64_t remembered;
    int64_t over_ground;
    int64_t keeps_in_view;
    int64_t looks_ahead;
    double period_s;
    double frequency_rad_s;
    double damping;
    double lag_s;
    double tilt_max_m_s2;
    double climb_lag_s;
    double climb_max_m_s;
    double view_forward_m;
    double view_right_m;
    double half_forward_rad;
    double half_right_rad;
} law_params;

typedef struct {
    int64_t n;
    int64_t tilt_delay;
    int64_t climb_delay;
    double slowness_s;
    double p;
    double w;
    double a;
    double rate;
    double lag;
    double under_way[132];
} law_gains;

typedef struct {
    double p;
    double w;
    double d;
    double b;
    double lean;
    double rate;
    double lag;
    double under_way[132];
} law_axis;

typedef struct {
    double p;
    double w;
    double lean;
    double rate;
    double a_body;
    double a_deck;
} axis_measured;

typedef struct {
    double own;
    double lean;
    double rate;
} law_own;

typedef struct {
    int64_t begun;
    int64_t has_turn;
    double pushed_down_m_s2;
    double turn_yaw_rad;
    double turn_rate_rad_s;
    double climbs[132];
    law_axis axes[2];
    law_own own[2];
} law_memory;

typedef struct {
    int64_t goes_on;
    int64_t steers;
    int64_t has_deck;
    int64_t horizons;
    int64_t has_yaw;
    int64_t has_rate;
    int64_t has_wanted_yaw;
    int64_t has_lean_max;
    double dt;
    double share;
    double forecast_age_s;
    double heading_rad;
    double d[3];
    double v[3];
    double yaw_rad;
    double a_body[3];
    double w_body[3];
    double lean[2];
    double v_deck[3];
    double a_deck[3];
    double wanted[3];
    double rate_m_s;
    double rate_max_m_s;
    double speed_max_m_s;
    double wanted_yaw_rad;
    double lean_max_rad;
} law_cycle;

typedef struct {
    double a[2];
    double trim[2];
    double v[3];
    double yaw_rate_rad_s;
} law_command;

typedef struct {
    int64_t circles;
    int64_t figure;
    int64_t has_wedge;
    double radius_m[2];
    double sign[2];
} pad_region;

typedef struct {
    int64_t rectangles;
    int64_t x_cuts;
    int64_t y_cuts;
    int64_t sides;
    int64_t x0[320];
    int64_t x1[320];
    int64_t y0[320];
    int64_t y1[320];
    double x_m[64];
    double y_m[64];
    double from_x_m[64];
    double from_y_m[64];
    double to_x_m[64];
    double to_y_m[64];
} pad_figure;

typedef struct {
    int64_t sides;
    double nx[4];
    double ny[4];
    double offset_m[4];
    double beyond_m;
} pad_wedge;

typedef struct {
    int64_t on_figure;
    int64_t beside_figure;
    double inside_m;
    double outside_m;
    double thinnest_m;
    double box_m[4];
    double box_radius_m;
} edge_zone;

typedef struct {
    int64_t contrast_count;
    int64_t pointer_kind;
    int64_t pointer_contrast;
    int64_t pointer_figure;
    int64_t lies_on[5];
    int64_t contrast_of_kind[5];
    int64_t paint_of_kind[5];
    double disc_radius_m;
    double half_length_m;
    double pointer_clear_m;
    double gap_m;
    double pointer_marks_m[8];
    double nominal[15];
    pad_region contrasts[5];
    pad_region kinds[5];
    pad_figure figures[4];
    pad_wedge wedge;
    edge_zone zones[5];
} pad_shape;

typedef struct {
    int64_t width;
    int64_t height;
    int64_t distorted;
    double fx;
    double fy;
    double cx;
    double cy;
    double distortion[5];
    double R_body_cam[9];
} camera_lens;

typedef struct {
    int64_t given;
    double roll_rad;
    double pitch_rad;
    double cov_tilt[4];
    double sigma_deck_rad;
} tilt_prior;

typedef struct {
    int64_t max_profiles;
    int64_t dense_pixels;
    double blur_px;
    double edge_sigma_px;
    double dense_edge_sigma_px;
    double size_sigma_m;
    double coded_px;
    double noise;
    double cut[3];
} fit_options;

typedef struct {
    double R[9];
    double t[3];
    double blur_px2[3];
    double m_per_px;
    double depth_m;
} fit_state;

typedef struct {
    double contrast_bgr[3];
    double snr;
    double in_view;
    double inliers;
    double likeness;
} edge_support;

typedef struct {
    int64_t dense;
    int64_t arrow_seen;
    int64_t doubted;
    double H[81];
    double cov[81];
    double noise_light;
    double edge_rms_px;
    double visible;
    double inliers;
    double last_step_px;
    fit_state state;
    edge_support edges[5];
} fit_solved;

typedef struct {
    int64_t dense;
    int64_t yaw_ambiguous;
    double R[9];
    double t[3];
    double cov[36];
    double information[36];
    double blur_px2[3];
    double noise_light;
    double edge_rms_px;
    double visible;
    double inliers;
    double last_step_px;
    edge_support edges[5];
} registration;

typedef struct {
    double roll_rad;
    double pitch_rad;
    double cov_tilt[4];
    double sigma_deck_rad;
    double R_body_cam[9];
    double t_body_cam[3];
    double R_cam_pad[9];
    double t_cam_pad[3];
    double cov_pose[36];
} camera_sighting;

typedef struct {
    double d[3];
    double R_level_pad[9];
    double cov_pose[36];
    double yaw_rad;
    double cov[16];
} level_sighting;

typedef struct {
    int64_t level;
    int64_t left;
    int64_t top;
    int64_t width;
    int64_t height;
} frame_part;

typedef struct {
    double R[9];
    double t[3];
} pad_pose;

typedef struct {
    int64_t n;
    int64_t disc_channel;
    int64_t arrow_rows;
    int64_t arrow_columns;
    int64_t disc_drawn;
    double per_m;
    double log_blur[5];
    double local_m;
    double reach_m;
    double disc_radius_m;
    double disc_edge_m;
    double h_half_length_m;
    double h_half_width_m;
    double ring_inner_m;
    double ring_outer_m;
    double arrow_tip_m;
    double arrow_depth_m;
    double arrow_half_base_m;
    double arrow_margin_m;
    double arrow_pitch_m;
    double orange_place[3];
    double h_side[3];
} pad_template;

typedef struct {
    int64_t steps;
    int64_t local;
    int64_t one_side;
    double sigma_tilt_rad;
    double side[2];
    double cut[3];
    double noise;
} alignment;

typedef struct {
    double noise;
    double contrast;
    double chroma;
} frame_quality;

typedef struct {
    double cut[3];
    double gain;
    double left;
} cover_line;

typedef struct {
    double paints[12];
    double local_paints[12];
    double sample_m;
    double in_view;
    double tilt_sigmas;
    double arrow[6];
    double features[31];
    double light_n[4];
    double light_mean[12];
    double light_var[12];
} aligned_pad;

typedef struct {
    int64_t has_field;
    int64_t has_ring;
    int64_t has_letters;
    int64_t has_fiducials;
    int64_t disc_has_colour;
    double orange_side[3];
    double orange_place[3];
    double template_weights[31];
    double weights[29];
} pad_judge;

typedef struct {
    int64_t coarse;
    double sigma_tilt_rad;
    double t_body_cam[3];
} look_options;

typedef struct {
    double mean[12];
    double var[12];
    double trust;
} pad_paint;

typedef struct {
    registration found;
    aligned_pad aligned;
    level_sighting seen;
    pad_paint paint;
    double evidence[29];
    double log_odds;
} looked_pad;

typedef struct {
    int64_t lamps;
    int64_t pairs;
    int64_t pair[40];
    double x_m[40];
    double y_m[40];
    double radius_m[40];
    double size_sigma_m;
    double t_body_cam[3];
} lamp_pattern;

typedef struct {
    pad_pose pose;
    double reach_px;
} lamps_expected;

typedef struct {
    int64_t lit;
    pad_pose pose;
    level_sighting seen;
    double cov[36];
    double confidence;
    double log10_odds;
    double uv_px[80];
} lamps_seen;

typedef struct {
    int64_t width;
    int64_t height;
    int64_t stride;
    int64_t room;
    int64_t margin;
    int64_t step;
    double R_cam_plane[9];
} search_image;

typedef struct {
    int64_t radii;
    int64_t most;
    int64_t only_bright;
    double least;
    double ratio;
} search_radii;

typedef struct {
    int64_t bright_inside;
    int64_t points;
    double centre[2];
    double radius;
    double support;
    double outline_px[72];
} search_circle;

typedef struct {
    double xy_m[1728];
    double area_inside[18];
    double ring[18];
    double h_marking[864];
    double arrow[864];
    double polarity;
    double radius_m;
} polar_pad;

typedef struct {
    double turn_rad;
    double score;
    double arrow;
    double in_view;
} polar_fit;

typedef struct {
    int64_t levels;
    int64_t plane_known;
    int64_t radii;
    int64_t width[5];
    int64_t height[5];
    int64_t stride[5];
    double R_cam_plane[9];
    double radius_m[4];
    double sign[4];
} search_frame;

typedef struct {
    double length_m;
    double width_m;
    double leg_m;
    double bar_m;
    double margin_m;
} pad_strokes;

typedef struct {
    int64_t width;
    int64_t height;
    int64_t stride;
    int64_t step;
    int64_t bright;
    int64_t plane_known;
    double R_cam_plane[9];
} strokes_image;

typedef struct {
    int64_t width;
    int64_t height;
    int64_t stride;
    int64_t full_width;
    int64_t full_height;
    int64_t full_stride;
    int64_t grey;
    int64_t most;
    double noise;
    double R_cam_plane[9];
} blob_image;

typedef struct {
    int64_t known;
    int64_t one_sided;
    double R[9];
    double t[3];
    double turn_rad;
    double drawing;
    double support;
    double side[2];
} search_guess;

typedef struct {
    double p[3];
    double v[3];
    double R[9];
    double w[3];
} deck;

typedef struct {
    double at_s;
    double rise_s;
    double hold_s;
    double v[2];
} gust;

typedef struct {
    int64_t on;
    int64_t logarithmic;
    int64_t dryden;
    int64_t wake;
    int64_t gusts;
    double speed_m_s;
    double along[2];
    double roughness_m;
    double log10m;
    double keep_ship;
    double block_m[2];
    double block_size[3];
    double wake_decay;
    double pad_yaw[2];
    gust gust[100];
} air_params;

typedef struct {
    int64_t quad_x;
    int64_t rotors;
    int64_t effect_by_rotor;
    int64_t flow_sees_deck;
    int64_t flow_works;
    int64_t motor_driven;
    int64_t all_healthy;
    int64_t delay_steps;
    double step_s;
    double mass_kg;
    double inertia_kg_m2[3];
    double thrust_max_n;
    double torque_max_n_m[3];
    double motor_lag;
    double arm_m;
    double rotor_radius_m;
    double rotors_above_m;
    double yaw_torque_per_thrust_m;
    double drag_per_s[3];
    double rotor_forward[6];
    double rotor_right[6];
    double rotor_spin[6];
    double rotor_squares[2];
    double effect_radius_m;
    double rotor_health[6];
    double landing_speed_m_s;
    double take_off_speed_m_s;
    double take_off_height_m;
    double motors_off_after_s;
    double tilt_cut_off_cos;
    double tilt_p;
    double tilt_d;
    double yaw_rate_p;
    double velocity_p;
    double velocity_d;
    double velocity_i;
    double velocity_i_max_m_s2;
    double climb_p;
    double climb_d;
    double climb_i;
    double climb_i_max_m_s2;
    double height_p;
    double observer_share;
    double unasked_max_rad_s2[3];
    double flow_scale;
    double flow_lag;
    double foot_m;
    double feet_below_m;
    double hull_top_m;
    double foot_n_m;
    double foot_n_s_m;
    double foot_stop_kg_s;
    double friction;
    double deck_fore_m;
    double deck_aft_m;
    double deck_middle_m;
    double deck_half_m;
    double deck_taper_m;
    double deck_yaw[2];
    double gust_sigma_m_s;
    double gust_keep;
    double gust_fresh;
    double flow_keep;
    double flow_fresh;
    double tilt_keep;
    double tilt_fresh;
    double wind[3];
    double tilt_max_rad;
    double extra_wind[3];
    double current[2];
    double euler_angle_max_rad;
    double vz_max_m_s;
    double yaw_rate_max_rad_s;
    air_params air;
} vehicle_params;

typedef struct {
    int64_t phase;
    int64_t tied;
    int64_t ditched;
    int64_t touched_what;
    int64_t touched_phase;
    int64_t pending_at;
    int64_t ship_known;
    double seconds;
    double p[3];
    double v[3];
    double q[4];
    double R[9];
    double w[3];
    double a[3];
    double thrust_n;
    double torque_n_m[3];
    double flow[2];
    double integral[3];
    double unasked_w[3];
    double unasked[3];
    double z_hold;
    double attached_d[3];
    double attached_q[4];
    double contact_s;
    double airborne_s;
    double touched_s;
    double touched_d[3];
    double touched_v[3];
    double touched_yaw;
    double gust[3];
    double flow_error[2];
    double tilt_bias[2];
    double tilt_drift[2];
    double air_u;
    double air_v[2];
    double air_w[2];
    double eddy[3];
    double ship[2];
    double air[3];
    double driven_n;
    double driven_n_m[3];
    double command[5];
    double pending[5120];
} vehicle;

typedef struct {
    int64_t echo_every;
    int64_t echo_delay;
    double step_s;
    double accel_sigma[2];
    double gyro_sigma[2];
    double accel_bias[3];
    double gyro_bias[3];
    double heading_bias;
    double field_bias[3];
    double field_sigma;
    double heading_keep;
    double heading_fresh;
    double pressure_keep;
    double pressure_fresh;
    double pressure_sigma;
    double cone_rad;
    double echo_sigma;
    double echo_min_m;
    double echo_max_m;
    double battery_life_s;
    double hover_n;
    int64_t motor[4];
} sensor_params;

typedef struct {
    int64_t tick;
    int64_t echoes;
    int64_t first_echo;
    double heading_drift;
    double pressure_drift;
    double noise[13];
    double battery;
    double echo_m;
    double echo_due[64];
    double echo_under_way_m[64];
} sensors;

typedef struct {
    double f_body[3];
    double w_body[3];
    double rpy_rad[3];
    double v_level_m_s[2];
    double magnetometer[3];
    double ultrasound_m;
    double pressure_pa;
    double battery;
    double motors_pwm[4];
} readings;

typedef struct {
    int64_t tick;
    int64_t every;
    double z;
    double vz;
} water;

typedef struct {
    double amplitude_m;
    double k[2];
    double w_rad_s;
    double phase_rad;
} wave;

typedef struct {
    double w_rad_s;
    double re[6];
    double im[6];
} harmonic;

typedef struct {
    double eta[6];
    double eta_dot[6];
    double eta_ddot[6];
} vessel_motion;

typedef struct {
    double p[3];
    double v[3];
    double a[3];
    double heading_rad;
} vessel_origin;

typedef struct {
    double d[3];
    double R[9];
} mount;

typedef struct {
    double p[3];
    double v[3];
    double a[3];
    double R[9];
    double w[3];
} mounted;

typedef struct {
    int64_t width;
    int64_t height;
    int64_t intra;
    int64_t quantizer;
    int64_t number;
} uvlc_picture;

/* estimator/core/base/digest.c */
uint32_t core_digest(void);

/* estimator/core/base/kalman.c */
int32_t nis_of(int32_t m, const double *innov, const double *S, double *nis);
void kalman_predict(int32_t n, const double *P, const double *F, const double *Q, double *P_after);
int32_t kalman_correct(int32_t n, int32_t m, const double *P, const double *innov, const double *H, const double *R, double *dx, double *P_after, double *S, double *nis);

/* estimator/core/base/symmetric.c */
void remove_attitude(int32_t m, double *cov, const double *J, const double *cov_attitude);

/* estimator/core/filter/answer.c */
void filter_answer(const filter_params *o, int64_t t, const belief *before, const double *P_before, answer *out);

/* estimator/core/filter/bank.c */
void bank_begin(const bank_members *m, sea *after);
void bank_observe(const filter_params *o, int64_t t, const double *y, const double *var, double ins_var, double reach_m, const sea *before, sea *after);

/* estimator/core/filter/bank_ahead.c */
void bank_reach(const bank_members *m, int32_t n, const double *horizons_s, horizon_reach *out);

/* estimator/core/filter/forecast.c */
int32_t filter_forecast(const filter_params *o, int64_t t, const belief *before, const double *P_before, const sea *bank, int32_t n, const double *horizons_s, const horizon_reach *reach, deck_ahead *out);

/* estimator/core/filter/run.c */
int32_t filter_run(const filter_params *o, int32_t n, const event *events, const sighting *sightings, const belief *before, const double *P_before, const sea *sea_before, belief *after, double *P_after, sea *sea_after, int64_t *P_index, int64_t *sea_index, outcome *outcomes);
int32_t filter_propagate(const filter_params *o, int32_t what, int64_t t, const belief *before, const double *P_before, belief *after, double *P_after);
void filter_settle(const filter_params *o, const belief *before, belief *after, double *F, double *Q);

/* estimator/core/filter/sighting.c */
int32_t sighting_model(const belief *b, const sighting *s, const double *cov_levelled_by, double yaw_sigma, int32_t place_only, double *innov, double *H, double *R, double *by_rate);

/* estimator/core/law/axis.c */
void law_observe(const law_params *o, const double *observer, double dt, double arrived, const law_axis *before, const axis_measured *z, law_axis *after);
double law_tilt(const law_axis *x, const law_gains *gains, double off_m, double a_deck, double a_deck_then);

/* estimator/core/law/law.c */
void law_step(const law_params *o, const law_gains *gains, const law_gains *gains_before, const double *observer, const law_cycle *in, const double *horizons_s, const double *rates_m_s, const law_memory *before, law_memory *after, law_command *out);

/* estimator/core/video/uvlc_decode.c */
int32_t uvlc_header(const uint8_t *data, int32_t bytes, uvlc_picture *picture);
int32_t uvlc_decode(const uint8_t *data, int32_t bytes, const uvlc_picture *picture, uint8_t *bgr);

/* estimator/core/vision/align/cover.c */
int32_t align_cover(const camera_lens *c, const pad_template *p, const int16_t *maps, const float *light, const frame_part *part, const uint8_t *px, int32_t stride, const pad_pose *pose, float *scratch, cover_line *out);

/* estimator/core/vision/align/fit.c */
int32_t align_fit(const camera_lens *c, const pad_template *p, const int16_t *maps, const int16_t *local_maps, const float *light, const frame_part *part, const uint8_t *px, int32_t stride, const frame_part *arrow_part, const uint8_t *arrow_px, int32_t arrow_stride, const pad_pose *pose, double tilt_sigmas, const double *cut, const frame_quality *of, float *scratch, aligned_pad *out);

/* estimator/core/vision/align/move.c */
int32_t align_move(const camera_lens *c, const pad_template *p, const int16_t *maps, const float *light, const frame_part *part, const uint8_t *px, int32_t stride, const alignment *how, pad_pose *pose, double *tilt_sigmas, float *scratch);

/* estimator/core/vision/align/view.c */
int32_t align_view(const camera_lens *c, const pad_template *p, const pad_pose *pose, int32_t most, frame_part *out);
void align_arrow_view(const camera_lens *c, const pad_template *p, const pad_pose *pose, frame_part *out);

/* estimator/core/vision/frame_noise.c */
void frame_noise(const uint8_t *px, int32_t stride, int32_t width, int32_t height, frame_quality *out);

/* estimator/core/vision/lamps/lamps.c */
int64_t lamps_room(const camera_lens *camera);
int32_t find_lamps(const camera_lens *camera, const uint8_t *frame, const uint16_t *light, const lamp_pattern *pad, const tilt_prior *prior, const lamps_expected *at, uint32_t *scratch, lamps_seen *out);

/* estimator/core/vision/look/look.c */
int32_t look_at_pad(const camera_lens *camera, const double *rays, const uint8_t *frame, const float *light, const float *lights, const pad_shape *shape, int32_t points, const double *edges, const int32_t *edge_of, const pad_template *drawn, const int16_t *maps, const int16_t *local_maps, const pad_judge *judge, const tilt_prior *prior, const fit_options *fit, const frame_quality *quality, const look_options *how, const pad_paint *known, const double *start, int32_t room, float *scratch, uint8_t *parts, looked_pad *out, double *outline);

/* estimator/core/vision/register/register.c */
int32_t register_pad(const camera_lens *camera, const double *rays, const uint8_t *frame, const float *light, const pad_shape *pad, int32_t points, const double *edges, const int32_t *edge_of, const tilt_prior *prior, const fit_options *o, const double *start, int32_t room, float *scratch, registration *out, double *outline);

/* estimator/core/vision/search/blobs.c */
int64_t search_blobs_room(const blob_image *image);
int32_t search_blobs(const camera_lens *c, const blob_image *image, const uint8_t *half, const uint8_t *full, float *scratch, search_circle *out);

/* estimator/core/vision/search/circles.c */
int64_t search_room(const search_image *image);
int32_t search_circles(const search_image *image, const uint8_t *grey, const float *rays, const search_radii *radii, float *scratch, search_circle *out);

/* estimator/core/vision/search/guesses.c */
int32_t search_guesses(const camera_lens *c, const polar_pad *pad, const search_frame *frame, const uint8_t *const *levels, int32_t circles, const search_circle *circle, int64_t *rated, const search_guess *before, int32_t most, search_guess *out);

/* estimator/core/vision/search/heading.c */
int32_t search_heading(const camera_lens *c, const polar_pad *pad, const pad_pose *pose, int32_t step, int32_t width, int32_t height, const uint8_t *px, int32_t stride, const double *side, polar_fit *out);

/* estimator/core/vision/search/strokes.c */
int64_t search_strokes_room(const strokes_image *image);
int32_t search_strokes(const camera_lens *c, const strokes_image *image, const pad_strokes *h, const uint8_t *px, float *scratch, int32_t most, search_guess *out);

/* estimator/core/vision/sighting_level.c */
void sighting_in_level(const camera_sighting *in, level_sighting *out);

/* sitl/core/physics/run.c */
int32_t sim_run(const vehicle_params *o, vehicle *v, const sensor_params *e, sensors *s, water *sea, int32_t harmonics, const wave *waves, int32_t n, const deck *decks, const double *noise, const double *air_noise, const double *sensor_noise);

/* sitl/core/physics/sensors.c */
void sensors_read(const vehicle_params *o, const vehicle *v, const sensor_params *e, const sensors *s, readings *out);

/* sitl/core/physics/vehicle.c */
void vehicle_step(const vehicle_params *o, vehicle *v, const deck *g, double sea_z, double sea_vz, const double *noise, const double *air_noise);
void vehicle_carry(vehicle *v, const deck *g);

/* sitl/core/physics/vessel.c */
void vessel_moved(int32_t harmonics, const harmonic *h, int32_t n, const double *t_s, vessel_motion *out);
void vessel_mounted(int32_t n, const vessel_origin *origin, const vessel_motion *m, const mount *at, mounted *out);

/* sitl/core/render/bounds.c */
void render_bounds(int32_t h, int32_t w, const uint8_t *mask, int32_t *covered, int32_t *open);

/* sitl/core/render/deck.c */
void render_deck(int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const float *cells, int32_t columns, const uint16_t *texels, int32_t texel_rows, int32_t texel_columns, const uint8_t *mask, uint16_t *scene);
void render_fill(int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const uint8_t *mask, const uint16_t *colour, uint16_t *scene);

/* sitl/core/render/lens.c */
void render_blur(int32_t h, int32_t w, const int16_t *light, int32_t radius, const uint16_t *taps, const int32_t *window, const int16_t *added, uint16_t *scratch, int16_t *out);
void render_frame(int32_t h, int32_t w, const int16_t *light, int32_t radius, const uint16_t *taps, const int32_t *window, const int16_t *added, const uint8_t *noise, const uint8_t *codes, uint16_t *scratch, uint8_t *frame);
void render_image(int32_t h, int32_t w, const uint16_t *scene, const uint8_t *kinds, const int16_t *gain, const float *exposure, const uint16_t *pad_scene, int32_t edges, const int32_t *where, const float *shares, int32_t radius, const uint16_t *taps, const int32_t *window, const int16_t *added, const uint8_t *noise, const uint8_t *codes, uint16_t *scratch, uint8_t *frame);

/* sitl/core/render/light.c */
void render_expose(int32_t pixels, const uint16_t *scene, const uint8_t *kinds, const int16_t *gain, const float *exposure, const uint16_t *pad_scene, int16_t *light);
void render_mix(int32_t edges, const int32_t *where, const float *shares, const uint16_t *scene, const int16_t *gain, const float *exposure, const uint16_t *pad_scene, int16_t *light);

/* sitl/core/render/meet.c */
void render_meet(int32_t count, const float *rays, const double *plane_from_ray, double most, float *places);

/* sitl/core/render/pad.c */
int32_t render_pad_kinds(int32_t h, int32_t w, const float *rays, const float *change, int32_t bent, const float *middles, const float *whole, int32_t rolling, int32_t regions, const float *pad, uint8_t *kinds, int32_t *edges);

/* sitl/core/render/pad_lens.c */
void render_pad_lens(int32_t w, const int32_t *window, const uint8_t *kinds, int32_t edges, const int32_t *where, const float *shares, int32_t fine, const float *parts, int32_t reach, const float *exact, const float *sampled, const uint16_t *scene, const int16_t *gain, const float *exposure, const uint16_t *pad_scene, int32_t *places, float *room, int16_t *added);

/* sitl/core/render/pad_shares.c */
void render_pad_shares(int32_t h, int32_t w, const float *rays, const float *change, int32_t bent, int32_t strokes, const float *stroke_numbers, int32_t rolling, int32_t regions, const float *pad, int32_t fine, int32_t count, const int32_t *edges, float *shares, float *parts);

/* sitl/core/render/shadow.c */
void render_shadow(int32_t h, int32_t w, const float *cells, int32_t columns, const float *shape, float soft, float share, const uint8_t *mask, int16_t *gain, int32_t *part);

/* sitl/core/render/smear.c */
void render_smear(int32_t h, int32_t w, const uint16_t *scene, int32_t count, const int32_t *shifts, const uint16_t *weights, uint16_t *smeared);
void render_average(int32_t h, int32_t w, const uint16_t *scene, const int32_t *shifts, uint16_t *averaged);

/* sitl/core/sea/surface.c */
void render_sea(int32_t h, int32_t w, const uint8_t *mask, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const float *cells, int32_t columns, const int16_t *small_texels, const int16_t *large_texels, const int16_t *caps_texels, const int16_t *streak_texels, const int32_t *sizes, const double *drift, const float *weights, const float *slow, const double *outlines, const int32_t *outline_points, const float *soft_m, uint8_t *codes);
void render_water(int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const uint8_t *codes, const uint16_t *colours, const uint8_t *mask, uint16_t *scene);

/* sitl/core/sea/swell.c */
void render_swell(int32_t rows, int32_t columns, const float *rays, const double *R_ned_cam, const double *plane_from_ray, const double *to_sun, double t_s, int32_t harmonics, const wave *waves, float *light);

/* sitl/core/video/uvlc_encode.c */
int32_t uvlc_encode(const uint8_t *bgr, const uvlc_picture *picture, int32_t room, uint8_t *out);

#ifndef INTERFACE_DIGEST
#define INTERFACE_DIGEST 4115954663u
#endif

#endif
