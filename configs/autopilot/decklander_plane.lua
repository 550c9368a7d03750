-- Lets a QuadPlane in GUIDED fly the velocities that Decklander sends.
--
-- ArduPlane 4.5 drops SET_POSITION_TARGET_LOCAL_NED with velocities, which ArduCopter flies by itself. This script reads them, and
-- moves the place and height that GUIDED holds along with them, at most LEASH_M from where the vehicle is. The position
-- controller of the VTOL motors flies to it; the velocity over the ground is fed forward. Where a setpoint has an acceleration
-- too, which Plane's scripts cannot hand on, it is fed forward as the step of velocity that makes the controller accelerate so.
--
-- Copy it to APM/scripts on the SD card, set SCR_ENABLE 1, Q_GUIDED_MODE 1 and reboot. It adds two parameters:
--   DKP_ENABLE    1 to steer, 0 to do nothing
--   DKP_SILENT_S  silence of the setpoints after which GUIDED holds the place where the vehicle is, seconds
--
-- The turn goes by the rudder's channel, as a MAVLink override of it: while the script steers, the rudder stick is not read.
--
-- It acts in GUIDED, armed, alone: any other mode takes the vehicle back. If the script itself ends, GUIDED holds the last place
-- and height by itself. No other script may read MAVLink messages beside it: ArduPilot has one queue for all of them.

local GUIDED = 15
local SETPOINT, LOCAL_NED = 84, 1    -- SET_POSITION_TARGET_LOCAL_NED and its MAV_FRAME
local USED, VELOCITY = 0x3F, 0x07    -- POSITION_TARGET_TYPEMASK of positions and velocities; positions alone are ignored
local NO_ACCELERATION, NO_YAW_RATE = 0x1C0, 0x800
local FASTEST_M_S = 20.0
local LEASH_M = 1.5
local PLACE_S = 0.3                  -- over which reported places, in steps of a centimetre, correct the integral of the velocity
local LAG_S = 0.2                    -- of the vehicle behind its velocity controller
local PERIOD_MS = 10
local TABLE = 140                    -- key of the parameter table, which must be the script's own

assert(param:add_table(TABLE, "DKP_", 2), "Decklander: the parameter table is taken")
assert(param:add_param(TABLE, 1, "ENABLE", 1), "Decklander: DKP_ENABLE cannot be added")
assert(param:add_param(TABLE, 2, "SILENT_S", 0.5), "Decklander: DKP_SILENT_S cannot be added")
mavlink:init(10, 1)
mavlink:register_rx_msgid(SETPOINT)

local velocity, heard_s = nil, nil   -- the newest setpoint, north, east and down in m/s, and when it came
local acceleration = nil             -- its acceleration, north and east in m/s^2; nil where it has none
local anchor, place = nil, nil       -- where the steering began, and the goal from there: north, east, down in m
local last_s = 0.0
local turn_rad_s, turned = 0.0, false
local RUDDER_MAX = 0.5               -- of the stick: full rudder could disarm

local function finite(v)
  return v == v and math.abs(v) <= FASTEST_M_S
end

-- A received message is ArduPilot's own structure: 12 bytes, then the payload.
local function listen(now_s)
  local own, message = param:get("SYSID_THISMAV"), mavlink:receive_chan()
  while message do
    local _, _, _, _, n, e, d, an, ae, _, _, turn, mask, system, _, frame = string.unpack("<I4fffffffffffI2BBB", message, 13)
    if frame == LOCAL_NED and system == own and mask & USED == VELOCITY and finite(n) and finite(e) and finite(d) then
      velocity, heard_s, acceleration = { n, e, d }, now_s, nil
      turn_rad_s = mask & NO_YAW_RATE == 0 and finite(turn) and turn or 0.0
      if mask & NO_ACCELERATION == 0 and finite(an) and finite(ae) then acceleration = { an, ae } end
    end
    message = mavlink:receive_chan()
  end
end

-- How far ahead of its own target the height must be so that the controller's input shaping asks for this speed: the inverse of
-- AC_PosControl's square root controller, whose gain is half the jerk over the acceleration.
local function lead_m(speed)
  local accel = param:get("Q_PILOT_ACCEL_Z") or 2.5
  local gain, most = 0.5 * (param:get("Q_P_JERK_Z") or 5.0) / accel, 0.5 * accel
  local v = math.abs(speed)
  local lead = v <= most / gain and v / gain or v * v / (2.0 * most) + most / (2.0 * gain * gain)
  return speed < 0.0 and -lead or lead
end

-- The step of velocity for one of acceleration: the controller's largest acceleration over its jerk, and the lag by which the
-- measured velocity, about which the setpoint is, comes behind the controller's own.
local function step_s()
  local most = math.max(0.01 * (param:get("Q_WP_ACCEL") or 100), 1.5 * (param:get("Q_TRANS_DECEL") or 2))
  return most / (param:get("Q_P_JERK_XY") or 5) + LAG_S
end

local function move(goal, from, north, east, up_m, v_north, v_east)
  local there, to, v = from:copy(), goal:copy(), Vector2f()
  there:offset(north, east)
  to:lat(there:lat())
  to:lng(there:lng())
  to:alt(from:alt() + math.floor(100.0 * up_m + 0.5))
  v:x(v_north)
  v:y(v_east)
  vehicle:update_target_location(goal, to)
  vehicle:set_velocity_match(v)
end

-- Turn by the rudder's channel; nil gives it back to the pilot.
local function rudder(rate_rad_s)
  local number = param:get("RCMAP_YAW") or 4
  local channel = rc:get_channel(math.floor(number))
  if not channel or (not rate_rad_s and not turned) then return end
  turned = rate_rad_s ~= nil
  if not turned then
    channel:set_override(0)
    return
  end
  local function of(what, default) return param:get(string.format("RC%d_%s", number, what)) or default end
  local expo = param:get("Q_PLT_Y_EXPO") or 0.25
  local share = math.deg(math.abs(rate_rad_s)) / math.max(param:get("Q_PLT_Y_RATE") or 100.0, 1.0)
  local stick = math.min(share / (1.0 - expo + expo * share), RUDDER_MAX)
  local trim, dead, right = of("TRIM", 1500), of("DZ", 30), rate_rad_s > 0.0
  if of("REVERSED", 0) == 1 then right = not right end
  local pwm = trim
  if stick > 0.002 then
    pwm = right and trim + dead + stick * (of("MAX", 1900) - trim - dead) or trim - dead - stick * (trim - dead - of("MIN", 1100))
  end
  channel:set_override(math.floor(pwm + 0.5))
end

local function leashed(wanted, is)
  return math.max(is - LEASH_M, math.min(is + LEASH_M, wanted))
end

local function update()
  local now_s = 0.001 * millis():tofloat()
  local dt_s = math.min(now_s - last_s, 0.1)
  last_s = now_s
  listen(now_s)
  local goal, here = vehicle:get_target_location(), ahrs:get_location()
  if vehicle:get_mode() ~= GUIDED or not arming:is_armed() or param:get("DKP_ENABLE") ~= 1 or not goal or not here then
    place, heard_s = nil, nil
    rudder(nil)
    return update, PERIOD_MS
  end
  if not heard_s or now_s - heard_s > param:get("DKP_SILENT_S") then
    if place then
      move(goal, here, 0.0, 0.0, 0.0, 0.0, 0.0)
      gcs:send_text(4, "Decklander: no setpoints, holding")
    end
    place, heard_s = nil, nil
    rudder(nil)
    return update, PERIOD_MS
  end
  if not place then
    anchor, place = here:copy(), { 0.0, 0.0, 0.0 }
  end
  local is = anchor:get_distance_NED(here)
  local north, east, now = velocity[1], velocity[2], ahrs:get_velocity_NED()
  if acceleration and now then
    -- The goal goes with the vehicle, so that nothing pulls it to a place.
    place[1] = place[1] + dt_s * now:x() + dt_s / PLACE_S * (is:x() - place[1])
    place[2] = place[2] + dt_s * now:y() + dt_s / PLACE_S * (is:y() - place[2])
    north, east = north + step_s() * acceleration[1], east + step_s() * acceleration[2]
  else
    place[1], place[2] = leashed(place[1] + dt_s * north, is:x()), leashed(place[2] + dt_s * east, is:y())
  end
  rudder(turn_rad_s)
  place[3] = leashed(place[3] + dt_s * velocity[3], is:z())
  move(goal, anchor, place[1], place[2], -place[3] - lead_m(velocity[3]), north, east)
  return update, PERIOD_MS
end

gcs:send_text(6, "Decklander: steers in GUIDED by velocities")
return update, PERIOD_MS
