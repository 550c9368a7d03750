-- Stops the motors of an ArduCopter that stands on the deck with a companion that has fallen silent.
--
-- A service that is killed in the last decimetres leaves the copter in GUIDED. It brakes, holds its place over the ground and
-- may come to stand on a deck that carries it along, armed, for as long as nobody comes. This script disarms it then.
--
-- ArduCopter 4.5 or newer. Copy it to APM/scripts on the SD card, set SCR_ENABLE 1 and reboot. It adds two parameters:
--   DKL_ENABLE    1 to disarm, 0 to do nothing
--   DKL_SILENT_S  silence of the companion's HEARTBEAT (component 191) after which it acts, seconds
--
-- The deck is known by what carries the copter. In the air the accelerometer measures the thrust: a copter at 60 % of its
-- hover throttle measures 0.6 g, and falls. On a deck it measures 1 g whatever its rotors do. Their difference in weights is
-- what the deck carries; neither a climb, a fall, a lean nor a gust makes it large for a second.

local COMPANION = 191                -- MAV_COMP_ID_ONBOARD_COMPUTER
local HEARTBEAT = 0
local GUIDED, BRAKE = 4, 17          -- the modes in which a dead companion leaves it; in any other one somebody else flies
local CARRIED = 0.45                 -- weights; ground effect and a strong updraught stay below 0.3
local FOR_S = 1.0                    -- for so long without a break
local LAG_S = 0.2                    -- of the low pass: longer than the ring of legs and airframe
local PERIOD_MS = 20
local G = 9.80665
local TABLE = 139                    -- key of the parameter table, which must be the script's own

assert(param:add_table(TABLE, "DKL_", 2), "Decklander: the parameter table is taken")
assert(param:add_param(TABLE, 1, "ENABLE", 1), "Decklander: DKL_ENABLE cannot be added")
assert(param:add_param(TABLE, 2, "SILENT_S", 2), "Decklander: DKL_SILENT_S cannot be added")
mavlink:init(1, 10)
mavlink:register_rx_msgid(HEARTBEAT)

local heard_s = nil                  -- when the companion was last heard; nil until it is heard in this flight
local carried = 0.0
local since_s = nil                  -- since when the deck carries it

-- A received message is ArduPilot's own structure: checksum (2 bytes), magic, length, two flags, sequence, system, component.
local function component_of(message)
  return string.byte(message, 9)
end

local function listen(now_s)
  local message = mavlink:receive_chan()
  while message do
    if component_of(message) == COMPANION then heard_s = now_s end
    message = mavlink:receive_chan()
  end
end

-- What carries the copter beside its rotors, in weights; nil where that is not known.
local function carried_now()
  local accel, throttle, hover = ahrs:get_accel(), motors:get_throttle(), param:get("MOT_THST_HOVER")
  if not accel or not throttle or not hover or hover < 0.05 then return nil end
  return -accel:z() / G - throttle / hover
end

local function update()
  local now_s = 0.001 * millis():tofloat()
  if not arming:is_armed() then
    listen(now_s)
    heard_s, since_s, carried = nil, nil, 0.0
    return update, PERIOD_MS
  end
  listen(now_s)
  local mode, now = vehicle:get_mode(), carried_now()
  local silent = heard_s and now_s - heard_s > param:get("DKL_SILENT_S")
  if not now or not silent or (mode ~= GUIDED and mode ~= BRAKE) or param:get("DKL_ENABLE") ~= 1 then
    since_s, carried = nil, now or 0.0
    return update, PERIOD_MS
  end
  carried = carried + (now - carried) * PERIOD_MS / (1000 * LAG_S + PERIOD_MS)
  if carried < CARRIED then
    since_s = nil
  elseif not since_s then
    since_s = now_s
  elseif now_s - since_s >= FOR_S then
    gcs:send_text(4, "Decklander: companion silent, on deck: disarming")
    arming:disarm()
    since_s = nil
  end
  return update, PERIOD_MS
end

gcs:send_text(6, "Decklander: disarms on deck when the companion is silent")
return update, PERIOD_MS
